"""Several complete stores into one."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from renderer.store import ShardRows, Store, StoreLayout, StoreWriter, store_exists
from renderer.store_location import is_remote, local_path, remove_store
from services.dataset.validation import checksum_faults
from services.version import data_version
from simcore.errors import InputError, StoreError

_ALIKE = ("scenes", "jitters", "inclinations_deg", "vertex_count", "picture_size")


def merge_stores(sources: Sequence[Store], out: str, listen: Callable[[int], None] = lambda shard: None) -> Store:
    """Copy the samples of several stores into a new one; materials are numbered on from store to store.

    One that was stopped goes on when it is called again; where a source fails, nothing is left of a new one.

    Rows keep their seeds, statuses and reasons; the configuration says which versions simulated the sources. The
    parameters decide nothing: the same fabric in two stores stays two materials.

    Args:
        sources: complete stores with the same scenes, repeats, inclinations and mesh.
        out: the new store.
        listen: called after each shard written.

    Raises:
        InputError: fewer than two stores, unlike or unfinished ones, something is at ``out``, or it lies in a source.
        StoreError: a place fails, or a source is damaged.
    """
    layout = _merged_layout(sources)
    _refuse_inside(sources, out)
    configuration = {
        "merged": [dict(source.stated["configuration"]) for source in sources],
        "merged_versions": [str(source.stated["software_version"]) for source in sources],
    }
    begun = store_exists(out)
    if begun:
        finished = _finished(out, layout, configuration)
        writer = StoreWriter.open(out)
    else:
        finished = np.zeros(layout.shards, dtype=np.bool_)
        seed = int(sources[0].stated["seed"])
        writer = StoreWriter.create(
            out, layout, configuration=configuration, seed=seed, software_version=data_version()
        )
    simulations = _simulations(sources)
    try:
        for shard in range(layout.shards):
            rows = [next(simulations) for _ in layout.shard_simulations(shard)]
            if not finished[shard]:
                writer.write_shard(shard, ShardRows.concatenate(rows))
            listen(shard)
    except StoreError as error:
        if not begun and error.code == "store_damaged":  # else the same command goes on where it was
            remove_store(out)
        raise
    return Store.open(out)


def _finished(out: str, layout: StoreLayout, configuration: dict[str, Any]) -> NDArray[np.bool_]:
    """Which shards a merge that was stopped has written.

    Raises:
        InputError: what is there is another store, or whole.
    """
    there = Store.open(out)
    same = there.layout == layout and there.stated["configuration"] == configuration
    if not same or there.complete.all() or there.stated["software_version"] != data_version():
        raise InputError(f"{out}: a store is there already; choose another --out", code="store_exists")
    return there.complete


def _refuse_inside(sources: Sequence[Store], out: str) -> None:
    if is_remote(out):
        return
    place = local_path(out).resolve()
    for source in sources:
        if not is_remote(source.url) and place.is_relative_to(local_path(source.url).resolve()):
            raise InputError(f"{out} would lie in {source.url}: choose another --out", code="merge_inside")


def _merged_layout(sources: Sequence[Store]) -> StoreLayout:
    if len(sources) < 2:
        raise InputError("give at least two stores to merge", code="merge_few")
    first = sources[0].layout
    for source in sources:
        for name in _ALIKE:
            if getattr(source.layout, name) != getattr(first, name):
                raise InputError(
                    f"{source.url} and {sources[0].url} differ in {name}; stores to be merged must be alike in it",
                    code="merge_unlike",
                )
        if not source.complete.all():
            raise InputError(f"{source.url} is unfinished; complete it with --resume first", code="merge_unfinished")
    return first.model_copy(
        update={
            "materials": sum(source.layout.materials for source in sources),
            # a pilot's are few, and a store of them has as many objects as simulations
            "simulations_per_shard": max(source.layout.simulations_per_shard for source in sources),
        }
    )


def _simulations(sources: Sequence[Store]) -> Iterator[ShardRows]:
    """Rows of every simulation of every store, materials renumbered."""
    offset = 0
    for source in sources:
        for shard in range(source.shards):
            if faults := checksum_faults(source, shard):
                raise StoreError(
                    f"{source.url}: {faults[0]}: see `drapemeter dataset validate`, and make the shard again",
                    code="store_damaged",
                )
            rows = source.read_shard(shard)
            rows = replace(rows, material=(rows.material + np.uint32(offset)).astype(np.uint32))
            for place in range(len(source.layout.shard_simulations(shard))):
                yield rows.simulation(place, source.layout.pictures)
        offset += source.layout.materials
