"""Optional physics and set-up changes that the effects of the catalogue switch on.

Everything is absent by default and then costs nothing. An effect (``diagnosis/effects``) returns a changed copy of
:class:`Mechanics` and :class:`~simcore.scenes.Setup`; the solver knows no effect by name.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from simcore.errors import InputError
from simcore.number import are_finite, check_finite, is_finite, is_number, shown
from simcore.scenes import GRAVITY_M_S2, Vector3

Array = NDArray[np.float64]

EDGES = ("left", "right", "top", "bottom")
LATER = {"later": True}
"""Of a field that came later: at its default it does not change the key of what is kept."""
LEAST_STIFFENING_STRAIN = 1e-6
"""Cloth whose moduli have doubled at less than this is of no textile, and its stiffness of no float."""


LARGEST = {
    "gravity_m_s2": 100.0,
    "air_pressure_pa": 1000.0,
    "off_grain_rad": math.pi,
    "hem_kg_m": 100.0,
    "trim_kg_m": 100.0,
    "adhesion_pa": 1000.0,
    "adhesion_range_m": 0.1,
    "friction": 100.0,
}
"""Beyond these no panel, room or hem is: a number in another unit, most likely."""
VECTORS = ("gravity_m_s2", "trim_kg_m")
"""Of these the length or the largest counts."""
LEAST_GRAVITY_M_S2 = 0.01
"""What a drape is at rest by is counted in weights."""
LARGEST_JITTER = {"force_weights": 100.0, "pin_m": 0.05, "placement_m": 0.5}
LARGEST_CURVATURE_1_M = 1e4
LARGEST_CREASE_RAD = 2.0 * math.pi
LEAST_WIDTH_M, LARGEST_WIDTH_M = 2.5e-3, 5.0
"""Narrower fields would be missed by, or count twice on, the parts of cells that they are taken at
(:data:`simcore.loads.PART_M`); no sample is larger."""


def _check_numbers(what: str, largest: float, *numbers: float) -> None:
    if not all(is_finite(n) for n in numbers):
        raise InputError(f"{what} needs finite numbers", code="mechanics")
    for number in numbers:
        if abs(number) > largest:
            raise InputError(f"{what} of {number:g} is beyond {largest:.4g}: is its unit right?", code="mechanics")


def _check_width(width_m: float, what: str) -> None:
    if not is_finite(width_m) or not LEAST_WIDTH_M <= width_m <= LARGEST_WIDTH_M:
        raise InputError(
            f"the width of {what}, {shown(width_m)} m, must be a number from {LEAST_WIDTH_M:g} to "
            f"{LARGEST_WIDTH_M:g} m",
            code="mechanics",
        )


class CurvatureField(Protocol):
    """A curvature the sample has when nothing acts on it."""

    def evaluate(self, u: Array, v: Array, size_m: tuple[float, float]) -> tuple[Array, Array]:
        """Rest curvature along weft and along warp [1/m] at material coordinates ``u``, ``v`` [m] (same shapes).

        Positive bends the sample's ends towards the camera.
        """
        ...


@dataclass(frozen=True)
class UniformCurvature:
    """The same everywhere, as of cloth that was stored on a roll [1/m]."""

    weft: float = 0.0
    warp: float = 0.0

    def __post_init__(self) -> None:
        _check_numbers("a uniform curvature [1/m]", LARGEST_CURVATURE_1_M, self.weft, self.warp)

    def evaluate(self, u: Array, v: Array, size_m: tuple[float, float]) -> tuple[Array, Array]:
        """See :class:`CurvatureField`."""
        return np.full(u.shape, self.weft), np.full(u.shape, self.warp)


@dataclass(frozen=True)
class EdgeCurl:
    """Curl across the free edges, as of a single jersey: ``curvature`` [1/m] at the edge, gone ``width_m`` inside it.

    ``edges`` names which of ``left``, ``right``, ``top``, ``bottom`` curl.
    """

    curvature: float
    width_m: float = 0.035
    edges: tuple[str, ...] = EDGES

    def __post_init__(self) -> None:
        _check_numbers("an edge curl [1/m]", LARGEST_CURVATURE_1_M, self.curvature)
        _check_width(self.width_m, "an edge curl's strip")
        edges: object = self.edges
        if isinstance(edges, str) or not isinstance(edges, Collection):
            raise InputError(f"the edges that curl are a tuple of names, not {shown(edges)}", code="mechanics")
        if unknown := [edge for edge in edges if edge not in EDGES]:
            raise InputError(f"no edge {unknown[0]!r} to curl: choose of {', '.join(EDGES)}", code="mechanics")

    def evaluate(self, u: Array, v: Array, size_m: tuple[float, float]) -> tuple[Array, Array]:
        """See :class:`CurvatureField`."""

        def bump(distance: Array) -> Array:
            return np.asarray(self.curvature * np.clip(1.0 - distance / self.width_m, 0.0, 1.0))

        zero = np.zeros(u.shape)
        weft = (bump(u) if "left" in self.edges else zero) + (bump(size_m[0] - u) if "right" in self.edges else zero)
        warp = (bump(v) if "top" in self.edges else zero) + (bump(size_m[1] - v) if "bottom" in self.edges else zero)
        return weft, warp


@dataclass(frozen=True)
class Crease:
    """A pressed fold line: it wants to be bent by ``angle_rad`` across a line at ``position`` (0 to 1) of the sample.

    ``along`` is ``warp`` (the line runs down the sample) or ``weft`` (across it); the angle is spread over
    ``width_m`` to either side of it, raised-cosine.
    """

    angle_rad: float
    along: str = "warp"
    position: float = 0.5
    width_m: float = 0.02

    def __post_init__(self) -> None:
        _check_numbers("a crease [rad]", LARGEST_CREASE_RAD, self.angle_rad)
        _check_width(self.width_m, "a crease")
        if self.along not in ("warp", "weft"):
            raise InputError(f"a crease runs along warp or weft, not {self.along!r}", code="mechanics")
        check_finite("the position of a crease", self.position, "mechanics")
        if not 0.0 <= self.position <= 1.0:
            raise InputError(
                f"a crease at {self.position:g} of the sample is not on it: give a share from 0 to 1", code="mechanics"
            )

    def evaluate(self, u: Array, v: Array, size_m: tuple[float, float]) -> tuple[Array, Array]:
        """See :class:`CurvatureField`."""
        across = u - self.position * size_m[0] if self.along == "warp" else v - self.position * size_m[1]
        # raised cosine of unit integral over twice the width
        shape = np.where(np.abs(across) < self.width_m, 0.5 * (1.0 + np.cos(np.pi * across / self.width_m)), 0.0)
        bump = np.asarray(self.angle_rad * shape / self.width_m)
        return (bump, np.zeros(u.shape)) if self.along == "warp" else (np.zeros(u.shape), bump)


@dataclass(frozen=True)
class FrozenCurvature:
    """Curvature left by earlier handling: smooth random, root mean square ``amplitude`` [1/m], drawn from ``seed``."""

    amplitude: float
    seed: int = 0
    wavelength_m: float = 0.12

    def __post_init__(self) -> None:
        _check_numbers("a frozen curvature [1/m]", LARGEST_CURVATURE_1_M, self.amplitude)
        if not is_finite(self.wavelength_m) or self.wavelength_m < LEAST_WIDTH_M:
            raise InputError(
                f"the waves of a frozen curvature, {shown(self.wavelength_m)} m, must be a number of "
                f"{LEAST_WIDTH_M:g} m or more",
                code="mechanics",
            )
        if not is_number(self.seed) or not 0 <= self.seed < math.inf or self.seed != int(self.seed):
            raise InputError(
                f"the seed of a frozen curvature must be a whole number, 0 or more, not {shown(self.seed)}",
                code="mechanics",
            )
        object.__setattr__(self, "seed", int(self.seed))

    def evaluate(self, u: Array, v: Array, size_m: tuple[float, float]) -> tuple[Array, Array]:
        """See :class:`CurvatureField`."""
        rng = np.random.default_rng(self.seed)
        waves = 24

        def field() -> Array:
            heading = rng.uniform(0.0, 2.0 * math.pi, waves)
            number = 2.0 * math.pi / (self.wavelength_m * rng.uniform(0.7, 1.5, waves))
            phase = rng.uniform(0.0, 2.0 * math.pi, waves)
            ku, kv = number * np.cos(heading), number * np.sin(heading)
            total = np.cos(u[..., None] * ku + v[..., None] * kv + phase).sum(axis=-1)
            return np.asarray(self.amplitude * total * math.sqrt(2.0 / waves))

        return field(), field()


@dataclass(frozen=True)
class Mechanics:
    """What acts on the cloth beyond the baseline.

    Attributes:
        gravity: acceleration [m/s²], panel frame; :data:`LEAST_GRAVITY_M_S2` or more.
        air_pressure_pa: pressure of a draft along +z on the whole sample, per rest area [Pa]; negative presses the
            cloth to the panel.
        off_grain_rad: angle by which the material's weft is turned from the sample's u towards v [rad].
        stiffening_strain: tensile Green-Lagrange strain at which the warp and weft moduli have doubled; None: never.
        rest_curvature: fields that add up.
        hem_kg_m: extra mass along the bottom edge [kg/m].
        trim_kg_m: extra mass along each of :data:`EDGES` [kg/m].
        adhesion_pa: largest pull of the panel on cloth near it [Pa], and within which distance [m].
        friction: coefficient of friction between cloth and panel.

    Raises:
        InputError: a value is not finite, beyond :data:`LARGEST` or has no physical meaning.
    """

    gravity: Vector3 = (0.0, -GRAVITY_M_S2, 0.0)
    air_pressure_pa: float = 0.0
    off_grain_rad: float = 0.0
    stiffening_strain: float | None = None
    rest_curvature: tuple[CurvatureField, ...] = ()
    hem_kg_m: float = 0.0
    adhesion_pa: float = 0.0
    adhesion_range_m: float = 3e-3
    friction: float = 0.0
    trim_kg_m: tuple[float, float, float, float] = field(default=(0.0, 0.0, 0.0, 0.0), metadata=LATER)

    def __post_init__(self) -> None:
        if not isinstance(self.rest_curvature, tuple):
            raise InputError("rest_curvature is a tuple of fields: give (field,) for one", code="mechanics")
        for curvature in self.rest_curvature:
            if isinstance(curvature, type) or not callable(getattr(curvature, "evaluate", None)):
                raise InputError(
                    f"rest_curvature holds {shown(curvature)}, no field: give UniformCurvature(...) or another one",
                    code="mechanics",
                )
        if not are_finite(self.gravity, 3):
            raise InputError(f"gravity needs three finite numbers [m/s²], got {shown(self.gravity)}", code="mechanics")
        if math.hypot(*self.gravity) < LEAST_GRAVITY_M_S2:
            raise InputError(
                f"gravity of {math.hypot(*self.gravity):g} m/s² is less than {LEAST_GRAVITY_M_S2}: the sample hangs by "
                "its weight",
                code="mechanics",
            )
        if not are_finite(self.trim_kg_m, len(EDGES)):
            raise InputError(
                f"masses along edges, trim_kg_m, are finite numbers, one each for {', '.join(EDGES)}, got "
                f"{shown(self.trim_kg_m)}",
                code="mechanics",
            )
        given = {name: getattr(self, name) for name in LARGEST if name not in VECTORS}
        for name, number in given.items():
            check_finite(name, number, "mechanics")
        strain = self.stiffening_strain
        if strain is not None and not is_finite(strain) and not (is_number(strain) and strain == math.inf):
            raise InputError(
                f"stiffening_strain must be a number, or None for none, got {shown(strain)}", code="mechanics"
            )
        if self.stiffening_strain is not None and not self.stiffening_strain >= LEAST_STIFFENING_STRAIN:
            raise InputError(
                f"stiffening strain {self.stiffening_strain:g} must be positive, {LEAST_STIFFENING_STRAIN:g} or more",
                code="mechanics",
            )
        unsigned = (self.hem_kg_m, *self.trim_kg_m, self.adhesion_pa, self.friction)
        if min(unsigned) < 0.0:
            raise InputError("masses along edges, adhesion and friction cannot be negative", code="mechanics")
        if not self.adhesion_range_m > 0.0:
            raise InputError(
                f"adhesion_range_m = {self.adhesion_range_m:g} must be positive; without adhesion give adhesion_pa = 0",
                code="mechanics",
            )
        sizes = {**given, "gravity_m_s2": math.hypot(*self.gravity), "trim_kg_m": max(self.trim_kg_m)}
        for name, size in sizes.items():
            if abs(size) > LARGEST[name]:
                raise InputError(f"{name} = {size:g} is beyond {LARGEST[name]:g}: is its unit right?", code="mechanics")


@dataclass(frozen=True)
class Jitter:
    """Scales of what differs between repeats of the same capture.

    Attributes:
        force_weights: root mean square of the smooth random initial forces, in vertex weights; they die out while the
            sample swings to rest.
        pin_m: standard deviation of each magnet's position along x and y [m], cut at 2.5 deviations.
        placement_m: amplitude of the random smooth shape the sample is put up from, out of plane [m].

    Raises:
        InputError: a scale is negative or beyond :data:`LARGEST_JITTER`.
    """

    force_weights: float = 1.0
    pin_m: float = 0.001
    placement_m: float = 0.02

    def __post_init__(self) -> None:
        for name, largest in LARGEST_JITTER.items():
            size = getattr(self, name)
            if not is_finite(size) or not 0.0 <= size <= largest:
                raise InputError(
                    f"{name} = {shown(size)} of a jitter must be a number from 0 to {largest:g}: is its unit right?",
                    code="mechanics",
                )


NO_JITTER = Jitter(0.0, 0.0, 0.0)
