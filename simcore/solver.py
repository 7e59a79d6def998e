"""(in work) Static drape solver: the signature the other packages build on."""

from __future__ import annotations

from simcore.drape import Drape
from simcore.mechanics import Jitter, Mechanics
from simcore.mesh import GridMesh
from simcore.parameters import FabricParameters
from simcore.scenes import Setup


class Solver:
    """Compiled once for a mesh, reused for any fabric, set-up, seed and mechanics. Not thread-safe; one a process."""

    def __init__(self, mesh: GridMesh) -> None:
        self.mesh = mesh

    def solve(
        self,
        fabric: FabricParameters,
        setup: Setup,
        *,
        seed: int | tuple[int, ...] = 0,
        jitter: Jitter = Jitter(),
        mechanics: Mechanics = Mechanics(),
        start: Drape | None = None,
        time_limit_s: float | None = None,
    ) -> Drape:
        """Bring the sample to rest; ``start`` continues from an earlier drape (no placement, no jitter)."""
        raise NotImplementedError
