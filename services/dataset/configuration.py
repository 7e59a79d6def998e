"""What a sweep is: everything that decides its bits, and nothing that does not (workers, addresses)."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from diagnosis.extension import MOST_PIN_RADIUS_M, AppliedEffect
from renderer.sensor import named_sensor
from renderer.store import StoreLayout
from services.dataset.solver_kind import SolverKind
from simcore.errors import InputError
from simcore.mesh import GridMesh
from simcore.parameters import PARAMETER_NAMES
from simcore.prior import DEFAULT_RANGES, check_ranges
from simcore.sampling import DesignKind
from simcore.scenes import Scene

MAX_INCLINATION_DEG = 5.0
IDEAL = "ideal"
"""The sensor that changes nothing."""

ADDED_LATER: Mapping[str, Any] = MappingProxyType({"simulator": [], "pin_radius_m": None, "solver": "single"})
"""Settings that stores of earlier versions do not state, and what they were made with."""

FULL_SHARD = 32
"""Simulations of a shard in large sweeps: with 11 pictures each about 6 MB and a minute of work."""

GPU_SHARD = 256
"""The same where a shard is solved at once on a GPU."""


MOST_MATERIALS = 2**24
"""Sixteen million fabrics, whose table takes 1 GB: more than anybody can simulate."""

MOST_JITTERS = 100_000


class SweepConfiguration(BaseModel):
    """A sweep, resolved; stored in the store's attributes and compared when a sweep is resumed.

    Attributes:
        materials: number of fabrics.
        jitters: repeats of each fabric and scene, from different initial forces, pins and placement.
        scenes: scene names.
        inclinations: pictures of each drape, evenly over ±5 degrees (1: upright).
        resolution_m: mesh cell [m].
        seed: of everything random.
        design: how the fabrics are chosen.
        ranges: lowest and highest value of each parameter, SI.
        fabrics_digest: SHA-256 of a listed or gridded design's fabrics, empty for drawn ones.
        simulations_per_shard: work of one task.
        time_limit_s: CPU seconds after which a simulation is given up.
        sensor: name of the sensor model that the depth goes through (:data:`renderer.sensor.SENSORS`).
        simulator: effects that are simulated beyond the baseline, each with its size.
        pin_radius_m: what a magnet holds round its corner; None: as in the baseline.
        solver: one simulation after the other, or a shard at once on the CPU or a GPU.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    materials: int = Field(ge=1, le=MOST_MATERIALS)
    jitters: int = Field(default=1, ge=1, le=MOST_JITTERS)
    scenes: tuple[str, ...] = ("hanging", "stretch")
    inclinations: int = Field(default=11, ge=1, le=101)
    resolution_m: float = 0.01
    seed: int = Field(default=0, ge=0, lt=2**63)
    design: DesignKind = DesignKind.SOBOL
    ranges: dict[str, tuple[float, float]] = Field(default_factory=lambda: dict(DEFAULT_RANGES))
    fabrics_digest: str = ""
    simulations_per_shard: int = Field(default=0, ge=0)
    time_limit_s: float = Field(default=120.0, gt=0, allow_inf_nan=False)
    sensor: str = IDEAL
    simulator: tuple[AppliedEffect, ...] = ()
    pin_radius_m: float | None = Field(default=None, ge=0.0, le=MOST_PIN_RADIUS_M, allow_inf_nan=False)
    solver: SolverKind = SolverKind.SINGLE

    @field_validator("scenes")
    @classmethod
    def _known_scenes(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        if not names or len(set(names)) != len(names):
            raise InputError("give each scene once, at least one of hanging and stretch", code="scenes")
        return tuple(Scene.parse(name).value for name in names)

    @field_validator("sensor")
    @classmethod
    def _known_sensor(cls, name: str) -> str:
        named_sensor(name)
        return name

    @field_validator("ranges")
    @classmethod
    def _usable_ranges(cls, ranges: dict[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
        merged = {**DEFAULT_RANGES, **check_ranges(ranges)}
        return {name: merged[name] for name in PARAMETER_NAMES}

    @classmethod
    def resolve(cls, **values: Any) -> SweepConfiguration:
        """A checked configuration with the shard size decided.

        Raises:
            InputError: a value cannot be used.
        """
        try:
            made = cls(**values)
        except ValidationError as error:
            first = error.errors()[0]
            name = ".".join(str(part) for part in first["loc"])
            raise InputError(f"{name}: {first['msg']} (got {first.get('input')!r})", code="sweep_value") from None
        simulations = made.materials * len(made.scenes) * made.jitters
        if made.simulations_per_shard > simulations:  # a shard is stored whole
            return made.model_copy(update={"simulations_per_shard": simulations})
        if not made.simulations_per_shard:
            full = GPU_SHARD if made.solver is SolverKind.CUDA else FULL_SHARD
            return made.model_copy(update={"simulations_per_shard": max(1, min(full, simulations // 16))})
        return made

    @property
    def mesh(self) -> GridMesh:
        """The mesh of every drape."""
        return GridMesh(self.resolution_m)

    @property
    def inclinations_deg(self) -> tuple[float, ...]:
        """Inclination of each picture [degree]."""
        if self.inclinations == 1:
            return (0.0,)
        return tuple(float(a) for a in np.linspace(-MAX_INCLINATION_DEG, MAX_INCLINATION_DEG, self.inclinations))

    @property
    def layout(self) -> StoreLayout:
        """Rows of the store."""
        return StoreLayout(
            materials=self.materials,
            scenes=self.scenes,
            jitters=self.jitters,
            inclinations_deg=self.inclinations_deg,
            simulations_per_shard=self.simulations_per_shard,
            vertex_count=self.mesh.vertex_count,
        )


def differences(stored: Mapping[str, Any], wanted: SweepConfiguration) -> list[str]:
    """Names of the settings in which a store's configuration and the wanted one differ."""
    plain, there = wanted.model_dump(mode="json"), {**ADDED_LATER, **stored}
    return sorted(name for name in {*plain, *there} if not _same(plain.get(name), there.get(name)))


def _same(a: Any, b: Any) -> bool:
    if isinstance(a, float) and isinstance(b, (int, float)):
        return math.isclose(a, b, rel_tol=1e-12)
    return bool(a == b)


def simulation_seed(seed: int, address: Sequence[int]) -> int:
    """Seed of one simulation, 64 bits, from the sweep's seed and (material, scene code, jitter).

    It is what the store's ``seed`` column holds and what ``drapemeter simulate --seed`` takes to make the drape again.
    """
    sequence = np.random.SeedSequence(seed, spawn_key=tuple(int(part) for part in address))
    return int(sequence.generate_state(1, np.uint64)[0])


def digest(values: np.ndarray[Any, Any]) -> str:
    """SHA-256 of numbers, hexadecimal."""
    return hashlib.sha256(np.ascontiguousarray(values, dtype="<f8").tobytes()).hexdigest()
