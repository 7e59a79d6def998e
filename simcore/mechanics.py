"""Optional physics and set-up changes that the effects of the catalogue switch on.

Everything is absent by default and then costs nothing. An effect (``diagnosis/effects``) is a function that returns a
changed copy of :class:`Mechanics` and :class:`~simcore.scenes.Setup`; the solver knows no effect by name.
"""

from __future__ import annotations

from dataclasses import dataclass

from simcore.scenes import GRAVITY_M_S2, Vector3


@dataclass(frozen=True)
class Mechanics:
    """What acts on the cloth beyond the baseline.

    Attributes:
        gravity: acceleration [m/s²], panel frame.
        air_pressure_pa: pressure of a draft along +z on the whole sample, per rest area [Pa]; negative presses the
            cloth to the panel.
        off_grain_rad: angle by which the material's weft is turned from the sample's u towards v [rad].
        stiffening_strain: tensile Green-Lagrange strain at which the warp and weft moduli have doubled; None: never.
    """

    gravity: Vector3 = (0.0, -GRAVITY_M_S2, 0.0)
    air_pressure_pa: float = 0.0
    off_grain_rad: float = 0.0
    stiffening_strain: float | None = None


@dataclass(frozen=True)
class Jitter:
    """Scales of what differs between repeats of the same capture.

    Attributes:
        force_weights: standard deviation of the random initial forces, in vertex weights.
        pin_m: standard deviation of each magnet's position along x and y [m].
        placement_m: amplitude of the random smooth shape the sample is put up from, out of plane [m].
    """

    force_weights: float = 1.0
    pin_m: float = 0.001
    placement_m: float = 0.02


NO_JITTER = Jitter(0.0, 0.0, 0.0)
