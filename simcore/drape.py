"""What the solver returns."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from simcore.mesh import GridMesh

OUT_OF_TIME = "time limit"
"""What the reason of a drape begins with whose time was up."""


class DrapeStatus(StrEnum):
    """How a simulation ended."""

    STILL = "still"
    NOT_STILL = "not_still"
    UNDER_RESOLVED = "under_resolved"
    DIVERGED = "diverged"


@dataclass(frozen=True)
class Drape:
    """A sample at rest (or the reason why not).

    Attributes:
        mesh: the mesh the vertices belong to.
        vertices: positions [m], panel frame, float64, shape [vertex_count, 3].
        status: see :class:`DrapeStatus`; ``reason`` says more when it is not ``still``.
        residual: RMS out-of-balance force per free vertex, in vertex weights; still is below 1e-3.
        energy: total potential energy [J], gravity measured from y = 0.
        stable: the exact Hessian has no negative curvature there.
        iterations: steps in all: those of Newton's method on every level (the steps of limited-memory BFGS between its
            factorisations are not counted), the Euler steps of each putting up (60, fewer where time was up), and all
            of further attempts, which were put up one by one or with contact of the cloth with itself.
        seconds: CPU seconds of the solve, further attempts included.
    """

    mesh: GridMesh
    vertices: NDArray[np.float64]
    status: DrapeStatus
    residual: float
    energy: float
    stable: bool
    iterations: int
    seconds: float
    reason: str = ""

    @property
    def ok(self) -> bool:
        """The drape may be used: at rest and certified."""
        return self.status is DrapeStatus.STILL
