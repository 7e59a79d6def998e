"""Capture sets made by simulation, for the steps that want captures where there is no camera."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capture.capture_set import new_document, write_captures_json
from renderer.camera import Camera, frontal_pose
from renderer.depth import render_depth
from renderer.depth_png import write_depth_png
from simcore.errors import SimulationError
from simcore.mechanics import Mechanics
from simcore.mesh import GridMesh
from simcore.parameters import ESTIMATED_NAMES, FabricParameters
from simcore.scenes import Scene, Setup
from simcore.solver import Solver

CAMERA = Camera(width=640, height=480, fx=475.0, fy=475.0, cx=319.5, cy=239.5)
"""A depth camera of the usual kind, not the network's own."""
ATTEMPTS = 3


def simulate_captures(
    folder: Path,
    fabrics: Mapping[str, FabricParameters],
    *,
    repeats: int,
    resolution_m: float,
    seed: int,
    mechanics: Mechanics = Mechanics(),
    state_parameters: bool = False,
    on_done: Callable[[], None] | None = None,
) -> None:
    """Write a capture set of simulated drapes: each fabric in both scenes, ``repeats`` times.

    Args:
        folder: where; made if need be.
        fabrics: the fabrics by id.
        repeats: captures of each fabric in each scene.
        resolution_m: edge of a mesh cell [m].
        seed: of the jitter.
        mechanics: what acts on the cloth beyond the baseline.
        state_parameters: say the true parameters in the set; otherwise only the density.
        on_done: called after each capture.

    Raises:
        SimulationError: a drape did not come to rest.
    """
    folder.mkdir(parents=True, exist_ok=True)
    solver = Solver(GridMesh(resolution_m))
    pose = frontal_pose()
    captures = []
    for number, (name, fabric) in enumerate(fabrics.items()):
        for scene in Scene:
            for repeat in range(repeats):
                words = (seed, number, list(Scene).index(scene), repeat)
                vertices = _rest(solver, fabric, scene, words, mechanics)
                picture = f"{name}-{scene}-{repeat}.png"
                depth = render_depth(vertices, solver.mesh.triangles, CAMERA, pose)
                write_depth_png(folder / picture, depth, CAMERA.depth_unit_m)
                captures.append(
                    {
                        "id": f"{name}-{scene}-{repeat}",
                        "fabric": name,
                        "scene": scene.value,
                        "repeat": repeat,
                        "depth": picture,
                    }
                )
                if on_done is not None:
                    on_done()
    document = new_document(
        name=folder.name,
        camera=CAMERA,
        setup={"sample_size_m": [0.5, 0.5], "camera_from_panel": pose.tolist(), "panel": True, "pin_radius_m": 0.01},
        fabrics=[_describe(name, fabric, state_parameters) for name, fabric in fabrics.items()],
        captures=captures,
    )
    write_captures_json(document, folder)


def _rest(
    solver: Solver, fabric: FabricParameters, scene: Scene, words: tuple[int, ...], mechanics: Mechanics
) -> NDArray[np.float64]:
    reasons = []
    for attempt in range(ATTEMPTS):
        drape = solver.solve(fabric, Setup.nominal(scene), seed=(*words, attempt), mechanics=mechanics)
        if drape.ok:
            return drape.vertices
        reasons.append(f"{drape.status}: {drape.reason}")
    raise SimulationError(f"no {scene} drape came to rest ({'; '.join(reasons)}): try another --seed")


def _describe(name: str, fabric: FabricParameters, state_parameters: bool) -> dict[str, object]:
    values = fabric.as_dict()
    parameters = {key: values[key] for key in ESTIMATED_NAMES} if state_parameters else None
    return {"id": name, "density": fabric.density, "parameters": parameters, "parameters_cv": 0.07, "density_cv": 0.02}
