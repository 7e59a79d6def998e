"""What a depth camera does at edges and where it sees nothing: flying pixels, shadow, grazing loss, dropout.

Pictures are z-depth [m], float32 [H, W], 0 = no data; what is 0 stays 0. A magnitude of zero changes nothing.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from renderer.camera import Camera, ray_directions
from simcore.errors import InputError

Depth = NDArray[np.float32]
EDGE_JUMP_M = 0.01
"""Neighbouring pixels whose depths differ by more than this are the two sides of an edge [m]."""


def depth_edges(depth: Depth, jump_m: float = EDGE_JUMP_M) -> NDArray[np.bool_]:
    """Pixels with one of four neighbours more than ``jump_m`` [m] nearer or farther, bool [H, W]; holes are no edge."""
    edges = np.zeros(depth.shape, dtype=bool)
    for near, far in _neighbour_slices():
        a, b = depth[near], depth[far]
        jump = (a > 0) & (b > 0) & (np.abs(a - b) > jump_m)
        edges[near] |= jump
        edges[far] |= jump
    return edges


def add_flying_pixels(depth: Depth, fraction: float, rng: np.random.Generator, jump_m: float = EDGE_JUMP_M) -> Depth:
    """A share ``fraction`` of the edge pixels reads somewhere between the two sides of the edge, uniformly.

    A pixel that straddles an edge mixes the light of both surfaces.

    Args:
        depth: z-depth [m], float32 [H, W].
        fraction: share of the edge pixels, 0 to 1.
        rng: source of randomness.
        jump_m: a larger step between neighbours is an edge [m].

    Returns:
        float32 [H, W], metres.

    Raises:
        InputError: the share is out of range.
    """
    if not 0.0 <= fraction <= 1.0:
        raise InputError(f"flying pixels {fraction} must be a share from 0 to 1", code="sensor_flying_pixels")
    if fraction == 0.0:
        return depth.copy()
    near, far = depth.copy(), depth.copy()
    for a, b in _neighbour_slices():
        both = (depth[a] > 0) & (depth[b] > 0)
        for here, there in ((a, b), (b, a)):
            near[here] = np.where(both, np.minimum(near[here], depth[there]), near[here])
            far[here] = np.where(both, np.maximum(far[here], depth[there]), far[here])
    chosen = depth_edges(depth, jump_m) & (rng.random(depth.shape) < fraction)
    mixed = near + rng.random(depth.shape).astype(np.float32) * (far - near)
    return np.where(chosen, mixed, depth).astype(np.float32)


def drop_readings(depth: Depth, fraction: float, rng: np.random.Generator, patch_px: float = 0.0) -> Depth:
    """Lose a share ``fraction`` of the readings at random.

    Args:
        depth: z-depth [m], float32 [H, W].
        fraction: share lost, 0 to 1.
        rng: source of randomness.
        patch_px: size of the holes (standard deviation of the blurred noise that is cut); 0 = single pixels.

    Returns:
        float32 [H, W], metres.

    Raises:
        InputError: share or size is out of range.
    """
    from scipy.ndimage import gaussian_filter

    if not 0.0 <= fraction <= 1.0:
        raise InputError(f"dropout {fraction} must be a share from 0 to 1", code="sensor_dropout")
    if not 0.0 <= patch_px <= 100.0:
        raise InputError(f"dropout patches of {patch_px} px must be from 0 to 100", code="sensor_dropout")
    if fraction == 0.0:
        return depth.copy()
    if patch_px == 0.0:
        lost = rng.random(depth.shape) < fraction
    else:
        field = gaussian_filter(rng.standard_normal(depth.shape), patch_px, mode="wrap")
        lost = field < np.quantile(field, fraction)
    return np.where(lost, np.float32(0.0), depth)


def drop_edges(depth: Depth, fraction: float, rng: np.random.Generator, jump_m: float = EDGE_JUMP_M) -> Depth:
    """Lose a share ``fraction`` of the pixels at depth edges, steps of more than ``jump_m`` [m]; float32 [H, W].

    Raises:
        InputError: the share is out of range.
    """
    if not 0.0 <= fraction <= 1.0:
        raise InputError(f"edge dropout {fraction} must be a share from 0 to 1", code="sensor_edge_dropout")
    if fraction == 0.0:
        return depth.copy()
    lost = depth_edges(depth, jump_m) & (rng.random(depth.shape) < fraction)
    return np.where(lost, np.float32(0.0), depth)


def drop_grazing(depth: Depth, camera: Camera, limit_deg: float) -> Depth:
    """Lose surface whose normal is turned from the line of sight by more than ``limit_deg`` [degree]; 90 loses nothing.

    The slope is that of the flatter one-sided difference along each axis, so that edges do not count as steep surface.

    Args:
        depth: z-depth [m], float32, shape [camera.height, camera.width].
        camera: that took it.
        limit_deg: above 0 and at most 90 [degree].

    Returns:
        float32 [H, W], metres.

    Raises:
        InputError: the limit is out of range.
    """
    if not 0.0 < limit_deg <= 90.0:
        raise InputError(f"grazing limit {limit_deg} degrees must be above 0 and at most 90", code="sensor_grazing")
    if limit_deg == 90.0:
        return depth.copy()
    z = np.where(depth > 0, depth, np.nan).astype(np.float64)
    a, b = np.moveaxis(ray_directions(camera)[..., :2], -1, 0)
    p, q = camera.fx * _flatter_slope(z, 1) / z, camera.fy * _flatter_slope(z, 0) / z
    # The normal (-p, -q, 1 + a p + b q) times the ray (a, b, 1) is one.
    lengths = (p**2 + q**2 + (1.0 + a * p + b * q) ** 2) * (a**2 + b**2 + 1.0)
    steep = np.nan_to_num(lengths, nan=0.0) > 1.0 / math.cos(math.radians(limit_deg)) ** 2
    return np.where(steep, np.float32(0.0), depth)


def _flatter_slope(z: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    """Of the differences to both neighbours along an axis the smaller one [m/pixel]; 0 where there is neither."""
    step = np.diff(z, axis=axis)
    nothing = np.full_like(np.take(z, [0], axis=axis), np.nan)
    before = np.concatenate([nothing, step], axis=axis)
    after = np.concatenate([step, nothing], axis=axis)
    flatter = np.where(
        np.nan_to_num(np.abs(before), nan=np.inf) <= np.nan_to_num(np.abs(after), nan=np.inf), before, after
    )
    return np.nan_to_num(flatter, nan=0.0)


def cast_shadow(depth: Depth, camera: Camera, baseline_m: float) -> Depth:
    """Lose what the projector does not light: it stands ``baseline_m`` to the camera's right (negative: left) [m].

    In the projector's picture a point of column c and depth z lies at c - fx baseline / z. Walking along a row these
    columns rise; a point that another one nearer overtakes is in its shadow. Lens distortion is left out.

    Args:
        depth: z-depth [m], float32, shape [camera.height, camera.width].
        camera: that took it.
        baseline_m: from -1 to 1 [m].

    Returns:
        float32 [H, W], metres.

    Raises:
        InputError: the baseline is out of range.
    """
    if not abs(baseline_m) <= 1.0:
        raise InputError(f"projector baseline {baseline_m} m must be from -1 to 1", code="sensor_shadow")
    if baseline_m == 0.0:
        return depth.copy()
    z = depth.astype(np.float64)
    if baseline_m < 0.0:
        return cast_shadow(depth[:, ::-1], camera, -baseline_m)[:, ::-1].copy()
    shift = np.divide(camera.fx * baseline_m, z, out=np.full(z.shape, -np.inf), where=z > 0)
    place = np.arange(depth.shape[1]) - shift  # +inf where there is no data: it shades nothing
    overtaken = np.minimum.accumulate(place[:, ::-1], axis=1)[:, ::-1] < place
    return np.where(overtaken, np.float32(0.0), depth)


def _neighbour_slices() -> tuple[tuple[tuple[slice, slice], tuple[slice, slice]], ...]:
    """Index pairs that lay every pixel on its right and on its lower neighbour."""
    everything, first, last = slice(None), slice(None, -1), slice(1, None)
    return (((everything, first), (everything, last)), ((first, everything), (last, everything)))
