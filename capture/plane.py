"""The panel's plane in a depth picture: robust fits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_TRIALS = 300
_SUBSAMPLE = 4000
_MAX_POINTS = 30_000
_TUKEY = 4.685
_STEPS = 14

LEAST_SPREAD_M = 0.001
"""How flat a panel is taken to be at best [m]."""


@dataclass(frozen=True)
class Plane:
    """A plane in the camera frame: ``normal . x = offset``.

    Attributes:
        normal: unit, towards the camera, float64 [3].
        offset_m: negative: the camera stands in front.
        rms_m: of the pixels that belong to it, robust.
        share: of all pixels with data that lie within three rms (at least 3 mm) of it.
    """

    normal: NDArray[np.float64]
    offset_m: float
    rms_m: float
    share: float

    def height(self, points: NDArray[np.floating]) -> NDArray[np.float64]:
        """Signed distance of points [..., 3] from the plane [m], positive towards the camera."""
        return np.asarray(points, dtype=np.float64) @ self.normal - self.offset_m

    @property
    def distance_m(self) -> float:
        """Distance of the camera from the plane [m]."""
        return -self.offset_m


def fit_plane(
    points: NDArray[np.float64],
    *,
    tolerance_m: float,
    spread_m: float = LEAST_SPREAD_M,
    seed: int = 0,
    minimum_share: float = 0.05,
) -> Plane | None:
    """The plane with the most points on it: RANSAC, then reweighted least squares with Tukey's weights.

    Args:
        points: [m], camera frame, shape [N, 3].
        tolerance_m: points within this distance support a trial plane.
        spread_m: see :func:`refine_plane`.
        seed: of the trials.
        minimum_share: fewer supporters than this share of the points are no plane.

    Returns:
        The plane, or None if there is none.
    """
    if len(points) < 50:
        return None
    rng = np.random.default_rng(seed)
    few = points[rng.choice(len(points), min(_SUBSAMPLE, len(points)), replace=False)]
    triples = few[rng.integers(0, len(few), (_TRIALS, 3))]
    normals = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    usable = lengths > 1e-6
    if not usable.any():
        return None
    normals = normals[usable] / lengths[usable, None]
    offsets = np.sum(normals * triples[usable, 0], axis=1)
    support = np.count_nonzero(np.abs(few @ normals.T - offsets) < tolerance_m, axis=0)
    best = int(np.argmax(support))
    if support[best] < minimum_share * len(few):
        return None
    return refine_plane(points, normals[best], float(offsets[best]), tolerance_m, spread_m=spread_m)


def refine_plane(
    points: NDArray[np.float64],
    normal: NDArray[np.float64],
    offset_m: float,
    tolerance_m: float,
    *,
    spread_m: float = LEAST_SPREAD_M,
) -> Plane:
    """Least squares from a first guess, reweighted with Tukey's weights of a width that shrinks.

    A width taken from the points themselves would settle between panel and cloth where the cloth fills the picture.

    Args:
        points: [m], camera frame, shape [N, 3].
        normal, offset_m: the guess; points beyond three times ``tolerance_m`` of it never count.
        tolerance_m: first width.
        spread_m: last width: the sensor's noise, or how flat a panel is.
    """
    points = points[:: 1 + len(points) // _MAX_POINTS]
    near = points[np.abs(points @ normal - offset_m) < 3.0 * tolerance_m]
    if len(near) < 10:
        return Plane(normal, offset_m, tolerance_m, 0.0)
    centre = near.mean(axis=0)
    for spread in np.geomspace(max(tolerance_m, spread_m), spread_m, _STEPS):
        weight = np.clip(1.0 - ((near @ normal - offset_m) / (_TUKEY * spread)) ** 2, 0.0, None) ** 2
        if weight.sum() < 10.0:
            break
        mean = np.average(near, axis=0, weights=weight)
        moved = near - mean
        normal = np.linalg.eigh((moved * weight[:, None]).T @ moved)[1][:, 0]
        offset_m = float(normal @ mean)
    if normal @ centre > 0.0:  # towards the camera, which stands at the origin
        normal, offset_m = -normal, -offset_m
    residual = np.abs(points @ normal - offset_m)
    members = residual[residual < _TUKEY * spread_m]
    rms = max(1.4826 * float(np.median(members)), 1e-6) if members.size else tolerance_m
    return Plane(normal, offset_m, rms, float(np.mean(residual < max(3.0 * rms, 3e-3))))
