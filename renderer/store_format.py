"""What a store of drapes looks like: version, row statuses, layout, arrays and codecs.

One Zarr v3 group. The samples run, slowest first, over materials, scenes, jitters and inclinations; a *simulation* is
one (material, scene, jitter) and has one drape and as many consecutive samples as there are inclinations. A *shard* is
what one task writes: the rows of a fixed number of whole simulations, one stored object in every array.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from simcore.errors import StoreError
from simcore.parameters import PARAMETER_NAMES, UNITS
from simcore.scenes import Scene

SCHEMA = "drapemeter-store/1"
DEPTH_UNIT_M = 1e-4
"""Metres per count of the stored depth; 0 counts mean no data."""

DIGEST_BYTES = hashlib.sha256().digest_size
SCENE_CODES: dict[str, int] = {Scene.HANGING.value: 0, Scene.STRETCH.value: 1}
SCENE_NAMES: dict[int, str] = {code: name for name, code in SCENE_CODES.items()}


class RowStatus(IntEnum):
    """How a sample ended, as stored; everything but ``OK`` is a failure with a reason."""

    MISSING = 0
    OK = 1
    NOT_STILL = 2
    UNDER_RESOLVED = 3
    DIVERGED = 4
    TIMED_OUT = 5
    BAD_RENDER = 6
    CRASHED = 7
    REFUSED = 8

    @property
    def label(self) -> str:
        """Name in reports, ``lower_snake_case``."""
        return self.name.lower()


class StoreLayout(BaseModel):
    """How many rows a store has and in which order; kept in the store's attributes.

    Attributes:
        materials, jitters: counts.
        scenes: scene names, in order.
        inclinations_deg: inclination of the sample in each of a simulation's pictures [degree].
        simulations_per_shard: simulations whose rows one shard holds (the last shard may hold fewer).
        vertex_count: vertices of one drape.
        picture_size: height and width of a depth picture [pixel].
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    materials: int = Field(ge=1)
    scenes: tuple[str, ...] = Field(min_length=1)
    jitters: int = Field(ge=1)
    inclinations_deg: tuple[float, ...] = Field(min_length=1)
    simulations_per_shard: int = Field(ge=1)
    vertex_count: int = Field(ge=4)
    picture_size: tuple[int, int] = (256, 256)

    @property
    def pictures(self) -> int:
        """Samples of one simulation."""
        return len(self.inclinations_deg)

    @property
    def simulations(self) -> int:
        """Simulations in all."""
        return self.materials * len(self.scenes) * self.jitters

    @property
    def samples(self) -> int:
        """Rows in all."""
        return self.simulations * self.pictures

    @property
    def shards(self) -> int:
        """Shards in all."""
        return -(-self.simulations // self.simulations_per_shard)

    @property
    def rows_per_shard(self) -> int:
        """Rows of a full shard."""
        return self.simulations_per_shard * self.pictures

    def shard_simulations(self, shard: int) -> range:
        """Simulation numbers of a shard."""
        first = shard * self.simulations_per_shard
        return range(first, min(first + self.simulations_per_shard, self.simulations))

    def shard_rows(self, shard: int) -> range:
        """Sample numbers of a shard."""
        simulations = self.shard_simulations(shard)
        return range(simulations.start * self.pictures, simulations.stop * self.pictures)

    def address(self, simulation: int) -> tuple[int, int, int]:
        """(material, position in ``scenes``, jitter) of a simulation."""
        rest, jitter = divmod(simulation, self.jitters)
        material, scene = divmod(rest, len(self.scenes))
        return material, scene, jitter

    def columns(self, rows: NDArray[np.integer[Any]] | range) -> dict[str, NDArray[Any]]:
        """What the columns that tell where a sample belongs hold in some rows, by name, shape [rows] each.

        Args:
            rows: sample numbers, shape [rows].
        """
        simulation, picture = np.divmod(np.asarray(rows, dtype=np.int64), self.pictures)
        rest, jitter = np.divmod(simulation, self.jitters)
        material, scene = np.divmod(rest, len(self.scenes))
        return {
            "material": material,
            "scene": np.array([SCENE_CODES[name] for name in self.scenes])[scene],
            "jitter": jitter,
            "inclination_deg": np.asarray(self.inclinations_deg, dtype=np.float32)[picture],
        }

    @classmethod
    def from_attributes(cls, value: Any) -> StoreLayout:
        """Layout as read from a store's attributes.

        Raises:
            StoreError: it is not a layout.
        """
        try:
            return cls.model_validate(value)
        except ValidationError as error:
            first = error.errors()[0]
            place = ".".join(str(p) for p in first["loc"])
            raise StoreError(f"the store's layout is damaged at {place}: {first['msg']}", code="store_layout") from None


@dataclass(frozen=True)
class ArraySpec:
    """One array of the contract.

    Attributes:
        name: path in the group.
        dtype: NumPy dtype, or ``str``.
        per: ``sample``, ``simulation`` or ``shard``: what the first axis counts.
        item: shape behind the first axis.
        fill: value of what was never written.
        attributes: unit and meaning.
    """

    name: str
    dtype: Any
    per: str
    item: tuple[int, ...] = ()
    fill: Any = 0
    attributes: dict[str, Any] | None = None

    @property
    def inner_chunk_of_one(self) -> bool:
        """Pictures and drapes are read one at a time: one item a chunk, many chunks a shard."""
        return len(self.item) >= 2


def array_specs(layout: StoreLayout) -> tuple[ArraySpec, ...]:
    """Every array of a store with this layout, the completion marks (``checksum``) last."""
    flags = {"flag_values": [int(s) for s in RowStatus], "flag_meanings": " ".join(s.label for s in RowStatus)}
    scenes = {"flag_values": list(SCENE_NAMES), "flag_meanings": " ".join(SCENE_NAMES.values())}
    named = {"names": list(PARAMETER_NAMES), "units": [UNITS[name] for name in PARAMETER_NAMES]}
    return (
        ArraySpec("depth", "uint16", "sample", layout.picture_size, 0, {"unit": "0.1 mm", "no_data": 0}),
        ArraySpec("parameters", "float32", "sample", (len(PARAMETER_NAMES),), 0.0, named),
        ArraySpec("scene", "uint8", "sample", attributes=scenes),
        ArraySpec("status", "uint8", "sample", attributes=flags),
        ArraySpec("reason", str, "sample", fill=""),
        ArraySpec("inclination_deg", "float32", "sample", fill=0.0, attributes={"unit": "degree"}),
        ArraySpec("seed", "uint64", "sample"),
        ArraySpec("material", "uint32", "sample"),
        ArraySpec("jitter", "uint32", "sample"),
        ArraySpec(
            "drapes/vertices", "float32", "simulation", (layout.vertex_count, 3), 0.0, {"unit": "m", "frame": "panel"}
        ),
        ArraySpec("drapes/residual", "float64", "simulation", fill=0.0, attributes={"unit": "vertex weight"}),
        ArraySpec("drapes/energy", "float64", "simulation", fill=0.0, attributes={"unit": "J"}),
        ArraySpec(
            "checksum", "uint8", "shard", (DIGEST_BYTES,), 0,
            {"meaning": "SHA-256 over a shard's stored objects; written after them, so zeros mean unfinished"},
        ),
    )  # fmt: skip


def per_shard(spec: ArraySpec, layout: StoreLayout) -> int:
    """Items of this array that one shard holds."""
    return {"sample": layout.rows_per_shard, "simulation": layout.simulations_per_shard, "shard": 1}[spec.per]


def object_key(spec: ArraySpec, shard: int) -> str:
    """Key of the one stored object of this array that belongs to a shard."""
    return "/".join([spec.name, "c", str(shard), *("0" for _ in spec.item)])


def combine_digests(digests: Sequence[tuple[str, bytes]]) -> bytes:
    """One SHA-256 over (key, SHA-256 of the stored bytes) pairs, in the order of the keys."""
    total = hashlib.sha256()
    for key, digest in sorted(digests):
        total.update(key.encode() + b"\0" + digest)
    return total.digest()
