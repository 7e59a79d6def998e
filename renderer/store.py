"""Reading a store of drapes (the design's Zarr contract); the writer is re-exported for convenience."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from renderer.depth_png import dequantise_depth
from renderer.store_format import (
    DEPTH_UNIT_M,
    SCENE_NAMES,
    RowStatus,
    StoreLayout,
    array_specs,
    object_key,
)
from renderer.store_location import (
    listed_sizes,
    lost_attributes,
    open_root,
    read_attributes,
    read_errors,
    store_exists,
)
from renderer.store_writer import ShardRows, StoreWriter
from simcore.errors import InputError, StoreError

__all__ = [
    "RowStatus",
    "ShardRows",
    "Store",
    "StoreLayout",
    "StoreWriter",
    "store_exists",
]


COLUMN_REQUESTS = 64
"""Requests under way at once while a whole column is read."""


class Store:
    """A store, read only. Small columns are read once and kept; pictures are read when asked for.

    Pickled as its URL: a data loader's worker opens it anew.
    """

    def __init__(self, url: str | Path, group: Any, attributes: Mapping[str, Any]) -> None:
        self.url = str(url)
        self.attributes = attributes
        self.layout = StoreLayout.from_attributes(attributes.get("layout"))
        self._group = group
        self._arrays: dict[str, Any] = {}

    @classmethod
    def open(cls, url: str | Path) -> Store:
        """Open a store.

        Raises:
            InputError: no store there, no permission, wrong credentials.
            StoreError: not a store of this schema, or the place fails.
        """
        found = open_root(url)
        if found is None:
            raise InputError(f"{url}: no store there", code="store_missing")
        group, attributes = found
        with read_errors(url):
            return cls(url, group, read_attributes(url, attributes))

    def __reduce__(self) -> tuple[Any, ...]:
        return (Store.open, (self.url,))

    def __len__(self) -> int:
        return self.layout.samples

    @cached_property
    def stated(self) -> Mapping[str, Any]:
        """The attributes, all of them there: configuration, layout, seed, software version.

        Raises:
            StoreError: one is lost.
        """
        if lost := lost_attributes(self.attributes):
            raise StoreError(
                f"{self.url}: damaged (its attribute {lost[0]} is missing or of another kind): put its zarr.json back",
                code="store_damaged",
            )
        return self.attributes

    @property
    def shards(self) -> int:
        """Number of shards."""
        return self.layout.shards

    def rows(self, shard: int) -> range:
        """Sample numbers of a shard."""
        return self.layout.shard_rows(shard)

    @cached_property
    def parameters(self) -> NDArray[np.float32]:
        """Fabric parameters, SI, order of ``PARAMETER_NAMES``, float32, shape [N, 7]."""
        return self.column("parameters")

    @cached_property
    def status(self) -> NDArray[np.uint8]:
        """Codes of :class:`RowStatus`, uint8, shape [N]."""
        return self.column("status")

    @cached_property
    def ok(self) -> NDArray[np.bool_]:
        """Which samples may be used, bool, shape [N]; none of a shard that is not finished."""
        return np.asarray((self.status == RowStatus.OK) & self.finished)

    @cached_property
    def materials(self) -> NDArray[np.uint32]:
        """Material index of each sample, uint32, shape [N]; split by it, never by sample."""
        return self.column("material")

    @cached_property
    def scene_codes(self) -> NDArray[np.uint8]:
        """Scene of each sample as stored (:data:`~renderer.store_format.SCENE_NAMES`), uint8, shape [N]."""
        return self.column("scene")

    @cached_property
    def scene(self) -> NDArray[Any]:
        """Scene name of each sample, str, shape [N]."""
        names = np.array([SCENE_NAMES[code] for code in range(len(SCENE_NAMES))])
        return np.asarray(names[self.scene_codes])

    @cached_property
    def jitter(self) -> NDArray[np.uint32]:
        """Repeat index of each sample, uint32, shape [N]."""
        return self.column("jitter")

    @cached_property
    def inclination_deg(self) -> NDArray[np.float32]:
        """Inclination of the sample in each picture [degree], float32, shape [N]."""
        return self.column("inclination_deg")

    @cached_property
    def reason(self) -> NDArray[Any]:
        """Why each failed sample failed, str, shape [N]."""
        return self.column("reason")

    @cached_property
    def checksums(self) -> NDArray[np.uint8]:
        """SHA-256 of each shard's objects, zeros while it is unfinished, uint8, shape [shards, 32]."""
        return self.column("checksum")

    @cached_property
    def complete(self) -> NDArray[np.bool_]:
        """Which shards are finished, bool, shape [shards]: those whose completion mark is there, found by listing."""
        from zarr.core.sync import sync

        async def marked() -> list[int]:
            prefix = "checksum/c/"
            return [int(key.split("/")[-2]) async for key in self._group.store.list_prefix(prefix) if key[-2:] == "/0"]

        finished = np.zeros(self.shards, dtype=np.bool_)
        with read_errors(self.url):
            finished[[shard for shard in sync(marked()) if shard < self.shards]] = True
        return finished

    @cached_property
    def finished(self) -> NDArray[np.bool_]:
        """Which samples lie in finished shards, bool, shape [N]."""
        return np.repeat(self.complete, self.layout.rows_per_shard)[: len(self)]

    def column(self, name: str) -> NDArray[Any]:
        """A whole array of the contract by name; mind the size of ``depth`` and ``drapes/vertices``."""
        import zarr

        # One small object a shard: many requests at once, or a large store takes an hour to open.
        with read_errors(self.url), zarr.config.set({"async.concurrency": COLUMN_REQUESTS}):
            return np.asarray(self.array(name)[:])

    def depth(self, sample: int) -> NDArray[np.float32]:
        """Depth picture of a sample [m], float32, shape [height, width], 0 = no data.

        Raises:
            IndexError: no such sample.
        """
        if not 0 <= sample < len(self):
            raise IndexError(f"sample {sample} is not one of {len(self)}")
        with read_errors(self.url):
            return dequantise_depth(self.array("depth")[sample], DEPTH_UNIT_M)

    def depth_counts(self, shard: int) -> NDArray[np.uint16]:
        """All depth pictures of a shard, 0.1 mm counts, uint16, shape [rows, height, width]."""
        rows = self.rows(shard)
        with read_errors(self.url):
            return np.asarray(self.array("depth")[rows.start : rows.stop])

    def depth_counts_of(self, samples: Sequence[int] | NDArray[np.integer[Any]]) -> NDArray[np.uint16]:
        """Depth pictures of a few samples, read one by one, 0.1 mm counts, uint16, shape [samples, height, width]."""
        with read_errors(self.url):
            depth = self.array("depth")
            return np.concatenate([np.asarray(depth[int(row) : int(row) + 1]) for row in samples])

    def vertices(self, simulation: int) -> NDArray[np.float32]:
        """Drape of a simulation [m], panel frame, float32, shape [vertex_count, 3]."""
        with read_errors(self.url):
            return np.asarray(self.array("drapes/vertices")[simulation])

    def read_shard(self, shard: int) -> ShardRows:
        """Everything of one shard, as it was written."""
        parts: dict[str, Any] = {}
        with read_errors(self.url):
            for spec in array_specs(self.layout)[:-1]:
                where = self.layout.shard_simulations(shard) if spec.per == "simulation" else self.rows(shard)
                parts[spec.name.removeprefix("drapes/")] = np.asarray(self.array(spec.name)[where.start : where.stop])
        return ShardRows(**parts)

    def stored_bytes(self, shard: int) -> dict[str, bytes | None]:
        """The stored objects of a shard by key, None where one is missing."""
        from zarr.core.buffer import default_buffer_prototype
        from zarr.core.sync import sync

        found: dict[str, bytes | None] = {}
        with read_errors(self.url):
            for spec in array_specs(self.layout)[:-1]:
                key = object_key(spec, shard)
                buffer = sync(self._group.store.get(key, default_buffer_prototype()))
                found[key] = None if buffer is None else buffer.to_bytes()
        return found

    def object_sizes(self) -> dict[str, int]:
        """Bytes that the objects of finished shards take, by array name (metadata is left out)."""
        finished = {str(shard) for shard in np.flatnonzero(self.complete)}
        sizes: dict[str, int] = {}
        with read_errors(self.url):
            for key, size in listed_sizes(self.url):
                name, _, part = key.partition("/c/")
                if part.split("/")[0] in finished:
                    sizes[name] = sizes.get(name, 0) + size
        return sizes

    def array(self, name: str) -> Any:
        """The Zarr array of that name.

        Raises:
            StoreError: it is lost, or what is there is none.
        """
        if name not in self._arrays:
            place = f"{self.url}: array {name}"
            with read_errors(place):
                try:
                    self._arrays[name] = self._group[name]
                except KeyError:
                    raise StoreError(
                        f"{place} is missing: put it back from a copy, or make the store again", code="store_damaged"
                    ) from None
        return self._arrays[name]
