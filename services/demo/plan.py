"""How large the demonstration is."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class DemoPlan:
    """Sizes of the steps; the defaults end in a few minutes on two cores.

    Attributes:
        seed: of everything random.
        fine_m: mesh cell of the drapes that are looked at [m].
        coarse_m: mesh cell of the drapes that are learnt from and compared [m].
        materials: fabrics in the store.
        epochs: passes of the training run.
        simulations: repeats of each fabric in each scene for the drape distance.
        repeats: captures of each fabric in each scene for the diagnosis.
    """

    seed: int = 0
    fine_m: float = 0.0125
    coarse_m: float = 0.025
    materials: int = 48
    epochs: int = 12
    simulations: int = 3
    repeats: int = 2
