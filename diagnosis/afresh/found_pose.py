"""A camera's pose that was found in the pictures, found again where simulations fit all that it saw.

Registered by outline and corners it is off by millimetres, the same in all pictures of one camera: which looks like an
effect that all fabrics share. What the simulations of all fabrics agree on says more.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.inference.noise import NoiseModel, feature_covariance
from diagnosis.measurement.features import measure
from diagnosis.measurement.reference import make_reference
from diagnosis.scene import SimulationScene
from diagnosis.simulation.pose_error import error_pose
from diagnosis.tasks.fabric_task import CaptureResult, CaptureTask, FabricResult, FabricTask

Array = NDArray[np.float64]
ALONG = [0, 1, 5]
"""What is found again: shifts along the panel and the turn about its normal. The panel shows the rest; without
one the pose's error grants it (:mod:`diagnosis.simulation.pose_error`)."""
POSE_STEPS = 8
"""Of Gauss-Newton, at most."""
NO_FURTHER = 0.05
"""A step of fewer standard deviations is the last."""


def with_poses_found(results: Sequence[FabricResult], noise: NoiseModel = NoiseModel()) -> list[FabricTask] | None:
    """The fabrics' tasks with poses found again; None where all are stated.

    Args:
        results: simulated with the poses as registered.
        noise: usual errors.
    """
    shown = [c for r in results for c in r.task.captures if not c.pose_known]
    if not shown:
        return None
    moved: dict[str, SimulationScene] = {}
    for rig in {(c.scene.camera, c.scene.pose) for c in shown}:
        moved |= _refound(results, {c.id: c for c in shown if (c.scene.camera, c.scene.pose) == rig}, noise)

    def again(capture: CaptureTask) -> CaptureTask:
        return replace(capture, scene=moved.get(capture.id, capture.scene))

    return [replace(r.task, captures=tuple(again(c) for c in r.task.captures)) for r in results]


def _refound(
    results: Sequence[FabricResult], seen: Mapping[str, CaptureTask], noise: NoiseModel
) -> dict[str, SimulationScene]:
    """The scenes of one camera's captures, by id, with its pose along the panel found again.

    Generalised least squares over all that it saw, by Gauss-Newton steps with the changes of the first, while the
    squares become fewer.
    """
    along_m = next(iter(seen.values())).pose_error_m
    scenes = {name: capture.scene for name, capture in seen.items()}
    found, fewest = scenes, np.inf
    total = np.zeros(6)
    for _ in range(POSE_STEPS):
        precision, right, squares = np.eye(len(ALONG)), -total[ALONG], float(total @ total)
        for result in results:
            for scene in sorted({c.scene for c in result.captures}):
                own = [c for c in result.captures if c.scene == scene and c.id in seen]
                if own:
                    measured = [_measured(c, seen[c.id], scenes[c.id]) for c in own]
                    rows, values = _whitened(own, np.concatenate(measured), result.task.relative_sigma, noise)
                    precision += rows @ rows.T
                    right += rows @ values
                    squares += float(values @ values)
        if squares >= fewest:
            break
        found, fewest = scenes, squares
        step = np.zeros(6)
        step[ALONG] = np.linalg.solve(precision, right)
        total += step
        scenes = {n: s.with_pose(s.camera_from_panel @ error_pose(step, along_m)) for n, s in scenes.items()}
        if np.abs(step).max() < NO_FURTHER:
            break
    return found


def _measured(result: CaptureResult, capture: CaptureTask, scene: SimulationScene) -> Array:
    """Against the state as a moved camera sees it, [cells + ring + 3]."""
    if scene == capture.scene:
        return result.measured.vector()
    return measure(capture.depth, make_reference(result.base.drape, scene), with_pixels=False).vector()


def _whitened(
    captures: Sequence[CaptureResult], measured: Array, sigma: Sequence[float], noise: NoiseModel
) -> tuple[Array, Array]:
    """Changes by the pose along the panel [3, n] and measurements [n] of the repeats, in units of all other errors."""
    from scipy.linalg import solve_triangular

    covariance = feature_covariance([replace(c, pose=None) for c in captures], sigma, noise)
    on_plane = np.concatenate([np.arange(c.reference.length) >= c.reference.count for c in captures])
    seen = np.isfinite(measured) & ~on_plane
    rows = np.concatenate([c.pose[ALONG] for c in captures if c.pose is not None], axis=1)[:, seen]
    factor = np.linalg.cholesky(covariance[np.ix_(seen, seen)])
    white = np.asarray(solve_triangular(factor, np.vstack([rows, measured[None, seen]]).T, lower=True).T)
    return white[:-1], white[-1]
