"""Steps that need only simulation and pictures: one drape, the sweeps, the distances between fabrics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from metric.backends import Backend, get_backend
from metric.drape_distance import drape_distance
from metric.feature_cache import FeatureCache
from metric.simulate import SimulationPlan, simulate_fabrics
from renderer.camera import CANONICAL_CAMERA, frontal_pose
from renderer.depth import render_depth
from renderer.depth_png import write_depth_png
from renderer.picture import write_png
from renderer.ply import write_ply
from renderer.shade import ShadedRenderer
from services.demo import fabrics, pictures
from simcore.errors import MissingResourceError, SimulationError
from simcore.mesh import GridMesh
from simcore.scenes import Scene, Setup
from simcore.solver import Solver


@dataclass(frozen=True)
class DistanceMatrix:
    """Drape distances between the named fabrics.

    Attributes:
        names: the fabrics.
        values: float64, shape [N, N]; the diagonal holds the distance between repeats of one fabric.
        backend: image distance used.
        unit: its unit, "" for none.
        notice: why another back end than LPIPS was taken, "" if it was not.
    """

    names: tuple[str, ...]
    values: NDArray[np.float64]
    backend: str
    unit: str
    notice: str


def one_drape(out: Path, resolution_m: float, seed: int) -> None:
    """Bring one fabric to rest in both scenes; write mesh, depth picture, its colours and the shaded picture.

    Raises:
        SimulationError: it did not come to rest.
    """
    solver = Solver(GridMesh(resolution_m))
    shader = ShadedRenderer(CANONICAL_CAMERA)
    for scene in Scene:
        drape = solver.solve(fabrics.NAMED["poplin"], Setup.nominal(scene), seed=seed)
        if not drape.ok:
            raise SimulationError(f"the {scene} drape is {drape.status}: {drape.reason}; try another --seed")
        triangles = drape.mesh.triangles
        depth = render_depth(drape.vertices, triangles, CANONICAL_CAMERA, frontal_pose())
        shaded = shader.render(drape.vertices, triangles, drape.mesh.uv, frontal_pose())
        write_ply(out / f"{scene}.ply", drape.vertices, triangles)
        write_depth_png(out / f"{scene}-depth.png", depth)
        pictures.write_height_map(out / f"{scene}-height.png", depth)
        write_png(out / f"{scene}-shaded.png", shaded)


def sweeps(path: Path, resolution_m: float, seed: int, on_done: Callable[[], None] | None = None) -> None:
    """Draw how drapes change as bending and stretch stiffness grow, in both scenes (as the paper's figure)."""
    bending, stretch = fabrics.bending_sweep(), fabrics.stretch_sweep()
    plan = SimulationPlan(simulations=1, resolution_m=resolution_m, seed=seed)
    renders = simulate_fabrics([*bending, *stretch], plan, on_done=on_done)
    rows = []
    for what, values, unit, found in (
        ("bending", fabrics.BENDING_SWEEP, "N·m", renders[: len(bending)]),
        ("stretch", fabrics.STRETCH_SWEEP, "N/m", renders[len(bending) :]),
    ):
        for scene in Scene:
            names = [f"{value:.1e} {unit}" if value < 1 else f"{value:.0f} {unit}" for value in values]
            rows.append((f"{what}, {scene}", names, [fabric.scenes[scene][0].need_shaded() for fabric in found]))
    pictures.write_rows(path, rows)


def distances(
    path: Path, resolution_m: float, simulations: int, seed: int, on_done: Callable[[], None] | None = None
) -> DistanceMatrix:
    """Drape distance of each pair of named fabrics, by LPIPS, or by depth where its weights are not to be had."""
    backend, notice = choose_backend()
    names = tuple(fabrics.NAMED)
    plan = SimulationPlan(simulations=simulations, resolution_m=resolution_m, seed=seed)
    renders = simulate_fabrics(list(fabrics.NAMED.values()), plan, on_done=on_done)
    cache = FeatureCache()
    values = np.zeros((len(names), len(names)))
    for j, a in enumerate(renders):
        for i, b in enumerate(renders[j:], start=j):
            other = None if i == j else b.scenes
            values[j, i] = values[i, j] = drape_distance(a.scenes, other, backend, cache=cache).distance
    matrix = DistanceMatrix(names, values, backend.name, backend.unit, notice)
    unit = f" [{backend.unit}]" if backend.unit else ""
    pictures.write_matrix(path, names, values, f"drape distance, {backend.name}{unit}; diagonal: repeats of one fabric")
    return matrix


def choose_backend() -> tuple[Backend, str]:
    """LPIPS; without its weights the depth back end, with a notice that says so."""
    try:
        return get_backend("lpips"), ""
    except MissingResourceError as error:
        return get_backend("depth"), f"LPIPS's weights are not here, so depth RMSE stands in: {error}"
