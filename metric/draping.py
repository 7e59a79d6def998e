"""One simulation and its pictures: what a worker process does."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from numpy.typing import NDArray

from metric.engine import engine_fingerprint
from metric.render import DrapeRender
from renderer.camera import CANONICAL_CAMERA, frontal_pose
from renderer.depth import render_depth
from renderer.shade import ShadedRenderer
from simcore.drape import Drape
from simcore.mesh import GridMesh
from simcore.parameters import FabricParameters
from simcore.scenes import Scene, Setup
from simcore.solver import Solver

_SCENE_WORDS = {Scene.HANGING: 0, Scene.STRETCH: 1}


@dataclass(frozen=True)
class DrapeRequest:
    """One simulation to run.

    Attributes:
        fabric: parameters.
        scene: scene.
        repeat: number of the repeat; each has initial forces of its own.
        seed: seed of the whole job.
        resolution_m: edge of a mesh cell [m].
        attempts: how often to try.
        failures: why the first of these attempts failed, where that is known: they are not made again. A request is
            the same with and without.
    """

    fabric: FabricParameters
    scene: Scene
    repeat: int
    seed: int
    resolution_m: float
    attempts: int = 3
    failures: tuple[str, ...] = field(default=(), compare=False)

    def solver_seed(self, attempt: int) -> tuple[int, ...]:
        """Words of the solver's seed sequence for one attempt."""
        word = int.from_bytes(hashlib.sha256(self.fabric.as_array().tobytes()).digest()[:4], "big")
        return (self.seed, word, _SCENE_WORDS[self.scene], self.repeat, attempt)


@dataclass(frozen=True)
class RequestResult:
    """What came of a request.

    Attributes:
        request: the request.
        render: pictures of the drape; None where no attempt came to rest.
        failures: why each failed attempt failed, in order.
        engine: fingerprint of the code and libraries that did it; empty: unknown.
    """

    request: DrapeRequest
    render: DrapeRender | None
    failures: tuple[str, ...] = ()
    engine: str = field(default="", compare=False)

    @property
    def settled(self) -> bool:
        """There are pictures, or no attempt is left to make."""
        return self.render is not None or len(self.failures) >= self.request.attempts


def run_request(request: DrapeRequest) -> RequestResult:
    """Simulate until one attempt comes to rest, then render. Runs in the process that owns the Taichi runtime."""
    failures = list(request.failures)
    for attempt in range(len(failures), request.attempts):
        drape = _solver(request.resolution_m).solve(
            request.fabric, Setup.nominal(request.scene), seed=request.solver_seed(attempt)
        )
        if drape.ok:
            return RequestResult(request, render_drape(drape), tuple(failures), engine_fingerprint())
        failures.append(f"{drape.status.value}, residual {drape.residual:.2g} {drape.reason}".strip())
    return RequestResult(request, None, tuple(failures), engine_fingerprint())


def render_drape(drape: Drape) -> DrapeRender:
    """Both pictures of a drape as the metric sees it: one camera, one light, grey Lambertian cloth, nothing behind."""
    return render_vertices(drape.vertices, drape.mesh)


def render_vertices(vertices: NDArray[np.floating], mesh: GridMesh) -> DrapeRender:
    """The same of vertices [m], panel frame, shape [vertex_count, 3]."""
    pose = frontal_pose()
    depth = render_depth(vertices, mesh.triangles, CANONICAL_CAMERA, pose, panel=False)
    shaded = _shader().render(vertices, mesh.triangles, mesh.uv, pose)
    return DrapeRender(
        shaded=np.asarray(shaded, np.uint8),
        depth=np.asarray(depth, np.float32),
        camera=CANONICAL_CAMERA,
        panel_depth_m=float(pose[2, 3]),
    )


@cache
def _solver(resolution_m: float) -> Solver:
    return Solver(GridMesh(resolution_m))


@cache
def _shader() -> ShadedRenderer:
    return ShadedRenderer(CANONICAL_CAMERA)
