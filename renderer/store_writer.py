"""Writing a store: laid out once, then whole shards only, each marked complete after its last object."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from renderer.store_format import (
    SCHEMA,
    ArraySpec,
    StoreLayout,
    array_specs,
    combine_digests,
    object_key,
    per_shard,
)
from renderer.store_location import (
    is_remote,
    listed_sizes,
    local_path,
    open_location,
    read_attributes,
    read_errors,
    store_errors,
    store_exists,
)
from simcore.errors import InputError, StoreError

if TYPE_CHECKING:
    from zarr.core.buffer import Buffer
    from zarr.storage import WrapperStore


METADATA = re.compile(r"zarr\.(json|[^/]*partial)")
"""Zarr's own objects, whole or in the middle of being written."""


@dataclass(frozen=True)
class ShardRows:
    """Everything that one shard holds; R rows of S simulations.

    Attributes:
        depth: 0.1 mm counts, uint16, shape [R, height, width].
        parameters: fabric parameters, SI, float32, shape [R, 7].
        scene, status: codes, uint8, shape [R].
        reason: why a row failed, empty where it did not, str, shape [R].
        inclination_deg: float32, shape [R].
        seed: seed of the row's simulation, uint64, shape [R].
        material, jitter: indices, uint32, shape [R].
        vertices: drapes [m], panel frame, float32, shape [S, vertex_count, 3]; NaN where there is none.
        residual, energy: of the drapes [vertex weight], [J], float64, shape [S].
    """

    depth: NDArray[np.uint16]
    parameters: NDArray[np.float32]
    scene: NDArray[np.uint8]
    status: NDArray[np.uint8]
    reason: NDArray[Any]
    inclination_deg: NDArray[np.float32]
    seed: NDArray[np.uint64]
    material: NDArray[np.uint32]
    jitter: NDArray[np.uint32]
    vertices: NDArray[np.float32]
    residual: NDArray[np.float64]
    energy: NDArray[np.float64]

    @classmethod
    def concatenate(cls, parts: list[ShardRows]) -> ShardRows:
        """Rows of several runs of simulations, one after the other."""
        return cls(**{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(cls)})

    def simulation(self, place: int, pictures: int) -> ShardRows:
        """Rows of one simulation.

        Args:
            place: of the simulation in this shard.
            pictures: samples of a simulation.
        """
        per_simulation = ("vertices", "residual", "energy")
        rows = slice(place * pictures, (place + 1) * pictures)
        parts = {
            f.name: getattr(self, f.name)[slice(place, place + 1) if f.name in per_simulation else rows]
            for f in fields(self)
        }
        return ShardRows(**parts)


class StoreWriter:
    """Writes whole shards of one store.

    Two processes that write rows of one shard overwrite each other's object without an error, so a part of a shard is
    refused. Any number of processes may write different shards.
    """

    def __init__(self, url: str | Path, group: Any, layout: StoreLayout, digests: dict[str, bytes]) -> None:
        self.url = url
        self.layout = layout
        self._group = group
        self._digests = digests
        self._arrays: dict[str, Any] = {}

    @classmethod
    def create(
        cls, url: str | Path, layout: StoreLayout, *, configuration: Mapping[str, Any], seed: int, software_version: str
    ) -> StoreWriter:
        """Lay out a new, empty store.

        Args:
            url: local folder or URL.
            layout: rows and their order.
            configuration: resolved configuration of the run, JSON values.
            seed: seed of the run.
            software_version: version that writes.

        Raises:
            InputError: something is there already, or the place cannot be written to.
            StoreError: the place fails.
        """
        import zarr

        with store_errors(url):
            _refuse_occupied(url, layout)
            location, digests = _recording(url)
            group = zarr.open_group(location, mode="a", zarr_format=3)
            for spec in array_specs(layout):
                _create_array(group, spec, layout)
            # The attributes come last: a store without them was killed while it was laid out.
            group.attrs.update(
                {
                    "schema": SCHEMA,
                    "configuration": dict(configuration),
                    "layout": layout.model_dump(mode="json"),
                    "seed": seed,
                    "software_version": software_version,
                }
            )
        return cls(url, group, layout, digests)

    @classmethod
    def open(cls, url: str | Path) -> StoreWriter:
        """Open a store that was laid out before, to write shards of it.

        Raises:
            InputError: no store there, or no permission.
            StoreError: the place fails, or is no store of this schema.
        """
        import zarr

        with store_errors(url):
            location, digests = _recording(url)
            group = zarr.open_group(location, mode="r+", zarr_format=3)
            layout = StoreLayout.from_attributes(read_attributes(url, dict(group.attrs))["layout"])
        return cls(url, group, layout, digests)

    def write_shard(self, shard: int, rows: ShardRows) -> str:
        """Write one whole shard, then its completion mark; writing it again replaces it, damaged or not.

        Returns:
            The shard's checksum, hexadecimal.

        Raises:
            StoreError: part of a shard, or arrays of other shapes (nothing is written), the place fails, or no space.
            InputError: no permission.
        """
        import zarr

        self._check_whole(shard, rows)
        self._digests.clear()
        with store_errors(self.url), zarr.config.set({"array.write_empty_chunks": True}):
            self._clear(shard)
            for spec in array_specs(self.layout)[:-1]:
                numbers = self.layout.shard_simulations(shard) if spec.per == "simulation" else None
                place = numbers if numbers is not None else self.layout.shard_rows(shard)
                self._array(spec)[place.start : place.stop] = getattr(rows, spec.name.removeprefix("drapes/"))
            total = combine_digests(list(self._digests.items()))
            self._array(array_specs(self.layout)[-1])[shard] = np.frombuffer(total, dtype=np.uint8)
        return total.hex()

    def status(self, shard: int) -> NDArray[np.uint8] | None:
        """Status of a finished shard's rows, uint8, shape [rows]; None where its completion mark is not there.

        Raises:
            StoreError: the place fails, or the shard is damaged.
        """
        from zarr.core.sync import sync

        *_, mark = array_specs(self.layout)
        with read_errors(self.url):
            if not sync(self._group.store.exists(object_key(mark, shard))):
                return None
            rows = self.layout.shard_rows(shard)
            ended: NDArray[np.uint8] = self._group["status"][rows.start : rows.stop]
            return ended

    def _clear(self, shard: int) -> None:
        """Remove a shard's objects, the mark first: Zarr reads what it writes over, and cannot read what is damaged."""
        from zarr.core.sync import sync

        for spec in reversed(array_specs(self.layout)):
            sync(self._group.store.delete(object_key(spec, shard)))

    def _array(self, spec: ArraySpec) -> Any:
        if spec.name not in self._arrays:
            self._arrays[spec.name] = self._group[spec.name]
        return self._arrays[spec.name]

    def _check_whole(self, shard: int, rows: ShardRows) -> None:
        if not 0 <= shard < self.layout.shards:
            raise StoreError(f"shard {shard} is not one of the store's {self.layout.shards}", code="shard_unknown")
        counts = {"sample": len(self.layout.shard_rows(shard)), "simulation": len(self.layout.shard_simulations(shard))}
        for spec in array_specs(self.layout)[:-1]:
            shape = np.shape(getattr(rows, spec.name.removeprefix("drapes/")))
            if shape != (counts[spec.per], *spec.item):
                raise StoreError(
                    f"shard {shard} takes {spec.name} of shape {(counts[spec.per], *spec.item)}, got {shape}: "
                    "write whole shards only, parts of one would overwrite each other",
                    code="partial_shard",
                )


def _refuse_occupied(url: str | Path, layout: StoreLayout) -> None:
    if store_exists(url):
        raise InputError(
            f"{url}: a store is there already; finish it with --resume or choose another --out", code="store_exists"
        )
    if not is_remote(url) and local_path(url).is_file():
        raise InputError(f"{url}: is there already and is no store; choose another --out", code="store_exists")
    # a store that was killed while it was laid out has metadata of its groups and arrays, and nothing else
    places = {"", *(f"{part}/" for spec in array_specs(layout) for part in (spec.name, spec.name.split("/")[0]))}
    keys = (key.rpartition("/") for key, _ in listed_sizes(url))
    if not all(f"{place}{slash}" in places and METADATA.fullmatch(name) for place, slash, name in keys):
        raise InputError(
            f"{url}: is there already and is no store, or one whose zarr.json is lost; choose another --out",
            code="store_exists",
        )


def _create_array(group: Any, spec: ArraySpec, layout: StoreLayout) -> None:
    from zarr.codecs import BloscCodec, BytesCodec
    from zarr.codecs.numcodecs import Delta

    length = {"sample": layout.samples, "simulation": layout.simulations, "shard": layout.shards}[spec.per]
    many = per_shard(spec, layout)
    options: dict[str, Any] = {"chunks": (many, *spec.item)}
    if spec.inner_chunk_of_one:
        options = {"chunks": (1, *spec.item), "shards": (many, *spec.item)}
    if spec.name == "depth":
        options |= {
            "filters": [Delta(dtype="<u2")],
            "serializer": BytesCodec(endian="little"),
            "compressors": [BloscCodec(typesize=2, cname="zstd", clevel=5, shuffle="bitshuffle")],
        }
    group.create_array(
        spec.name,
        shape=(length, *spec.item),
        dtype=spec.dtype,
        fill_value=spec.fill,
        attributes=spec.attributes,
        overwrite=True,
        **options,
    )


def _recording(url: str | Path) -> tuple[WrapperStore[Any], dict[str, bytes]]:
    """The place's storage, and the SHA-256 of each object written through it since the dictionary was last cleared."""
    from zarr.storage import WrapperStore

    digests: dict[str, bytes] = {}

    class RecordingStore(WrapperStore[Any]):
        async def set(self, key: str, value: Buffer) -> None:
            await self._store.set(key, value)
            digests[key] = hashlib.sha256(value.to_bytes()).digest()

        async def set_if_not_exists(self, key: str, value: Buffer) -> None:
            # Not every S3 server knows conditional writes; what is written so (metadata) is the same each time.
            if not await self._store.exists(key):
                await self._store.set(key, value)

    return RecordingStore(open_location(url, read_only=False)), digests
