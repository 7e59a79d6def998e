"""What is said of a solve: still, or why not."""

from __future__ import annotations

import math

import numpy as np

from simcore.cloths import Cloths
from simcore.drape import OUT_OF_TIME, DrapeStatus
from simcore.mesh import GridMesh
from simcore.newton import NewtonOptions, Rest
from simcore.resolution import FINE_CELL_M, LARGEST_RESISTANCE, kinked_share, largest_share, mesh_resistance


def verdict(mesh: GridMesh, cloth: Cloths, rest: Rest, crossings: int, late: bool) -> tuple[DrapeStatus, str]:
    """Status and reason of where Newton ended.

    Args:
        mesh: of the drape.
        cloth: its fields on that mesh, one cloth.
        rest: positions with residual, certificate and steps.
        crossings: edges that pierce triangles.
        late: the time limit has passed.
    """
    if not np.isfinite(rest.x).all() or not math.isfinite(rest.residual):
        return DrapeStatus.DIVERGED, "positions are not finite"
    said = f"{OUT_OF_TIME}; " if late else ""
    if not rest.converged:
        return DrapeStatus.NOT_STILL, f"{said}{_unrest(rest, late)} after {rest.iterations} steps"
    if crossings:
        return DrapeStatus.NOT_STILL, f"{said}the cloth passes through itself: {crossings} edges pierce a triangle"
    finer = f"use a mesh finer than {1e3 * mesh.resolution_m:g} mm"
    if (share := kinked_share(rest.x)) > largest_share(mesh.resolution_m):
        return DrapeStatus.UNDER_RESOLVED, (
            f"{100 * share:.0f} % of the sample folds by more than 45 degrees within a cell: {finer}"
        )
    if mesh.resolution_m <= FINE_CELL_M and (resistance := mesh_resistance(rest.x, cloth)) > LARGEST_RESISTANCE:
        return DrapeStatus.UNDER_RESOLVED, (
            f"the mesh resists the folds {resistance:.2g} times as much as the fabric's bending does: {finer}"
        )
    return DrapeStatus.STILL, ""


def _unrest(rest: Rest, late: bool) -> str:
    """What keeps a sample from being at rest."""
    if rest.residual >= NewtonOptions().tolerance or late:
        return f"residual {rest.residual:.2g} vertex weights"
    if not rest.stable:
        return "at a saddle that was not left"
    return "friction on the panel and what presses there had not settled"
