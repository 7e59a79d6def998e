"""Several complete stores into one."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from renderer.store import ShardRows, Store, StoreLayout, StoreWriter
from services.version import data_version
from simcore.errors import InputError

_ALIKE = ("scenes", "jitters", "inclinations_deg", "vertex_count", "picture_size")


def merge_stores(sources: Sequence[Store], out: str, listen: Callable[[int], None] = lambda shard: None) -> Store:
    """Copy the samples of several stores into a new one; materials are numbered on from store to store.

    Rows keep their seeds, statuses and reasons. The parameters decide nothing: the same fabric in two stores stays two
    materials.

    Args:
        sources: complete stores with the same scenes, repeats, inclinations and mesh.
        out: the new store.
        listen: called after each shard written.

    Raises:
        InputError: fewer than two stores, unlike or unfinished ones, or something is at ``out``.
        StoreError: a place fails.
    """
    layout = _merged_layout(sources)
    writer = StoreWriter.create(
        out,
        layout,
        configuration={"merged": [dict(source.attributes["configuration"]) for source in sources]},
        seed=int(sources[0].attributes["seed"]),
        software_version=data_version(),
    )
    simulations = _simulations(sources)
    for shard in range(layout.shards):
        rows = [next(simulations) for _ in layout.shard_simulations(shard)]
        writer.write_shard(shard, ShardRows.concatenate(rows))
        listen(shard)
    return Store.open(out)


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
    return first.model_copy(update={"materials": sum(source.layout.materials for source in sources)})


def _simulations(sources: Sequence[Store]) -> Iterator[ShardRows]:
    """Rows of every simulation of every store, materials renumbered."""
    offset = 0
    for source in sources:
        for shard in range(source.shards):
            rows = source.read_shard(shard)
            rows = replace(rows, material=(rows.material + np.uint32(offset)).astype(np.uint32))
            for place in range(len(source.layout.shard_simulations(shard))):
                yield rows.simulation(place, source.layout.pictures)
        offset += source.layout.materials
