"""What is asked of a solver of many drapes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from simcore.mechanics import Jitter, Mechanics
from simcore.parameters import FabricParameters
from simcore.scenes import Setup


@dataclass(frozen=True)
class Request:
    """One drape; see :meth:`simcore.solver.Solver.solve`."""

    fabric: FabricParameters
    setup: Setup
    seed: int | Sequence[int] | np.random.SeedSequence = 0
    jitter: Jitter = Jitter()
    mechanics: Mechanics = Mechanics()
