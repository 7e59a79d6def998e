"""What a depth camera does to each reading: scale, bias, range noise, quantisation, smoothing. One function each.

Pictures are z-depth [m], float32 [H, W], 0 = no data; what is 0 stays 0. A magnitude of zero changes nothing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simcore.errors import InputError

Depth = NDArray[np.float32]
MAX_DEPTH_M = 65.0


def scale_depth(depth: Depth, fraction: float) -> Depth:
    """Every depth times (1 + ``fraction``), float32 [H, W]: a camera whose baseline or focal length is off.

    Raises:
        InputError: the fraction is out of range.
    """
    if not -0.9 <= fraction <= 9.0:
        raise InputError(f"depth scale {fraction} must be from -0.9 to 9 (0 = none)", code="sensor_depth_scale")
    return (depth * np.float64(1.0 + fraction)).astype(np.float32)


def bias_depth(depth: Depth, offset_m: float) -> Depth:
    """Every depth plus ``offset_m`` [m], float32 [H, W]; readings that fall to 0 or below are lost.

    Raises:
        InputError: the offset is out of range.
    """
    if not abs(offset_m) <= MAX_DEPTH_M:
        raise InputError(
            f"depth bias {offset_m} m must be from {-MAX_DEPTH_M:g} to {MAX_DEPTH_M:g} (0 = none)",
            code="sensor_depth_bias",
        )
    moved = np.where(depth > 0, depth.astype(np.float64) + offset_m, 0.0)
    return np.maximum(moved, 0.0).astype(np.float32)


def add_range_noise(depth: Depth, sigma_m: float, at_m: float, rng: np.random.Generator) -> Depth:
    """White Gaussian noise along z whose standard deviation is ``sigma_m`` at depth ``at_m`` and grows as z².

    Triangulation (structured light, stereo) measures disparity d = f b / z with a constant error, so that
    dz = z² / (f b) dd. Readings that fall to 0 or below are lost.

    Args:
        depth: z-depth [m], float32 [H, W].
        sigma_m: from 0 to 1 [m].
        at_m: reference depth, above 0 [m].
        rng: source of randomness.

    Returns:
        float32 [H, W], metres.

    Raises:
        InputError: noise or reference depth is out of range.
    """
    if not 0.0 <= sigma_m <= 1.0:
        raise InputError(f"range noise {sigma_m} m must be from 0 to 1", code="sensor_range_noise")
    if not 0.0 < at_m <= MAX_DEPTH_M:
        raise InputError(
            f"range noise's reference depth {at_m} m must be above 0 and at most {MAX_DEPTH_M:g}",
            code="sensor_range_noise",
        )
    if sigma_m == 0.0:
        return depth.copy()
    z = depth.astype(np.float64)
    noisy = z + sigma_m * (z / at_m) ** 2 * rng.standard_normal(depth.shape)
    return np.where(depth > 0, np.maximum(noisy, 0.0), 0.0).astype(np.float32)


def quantise_uniform(depth: Depth, step_m: float) -> Depth:
    """Round to whole multiples of ``step_m`` [m], the same at every depth, as the capture sets at hand show.

    Returns:
        float32 [H, W], metres.

    Raises:
        InputError: the step is out of range.
    """
    _check_step(step_m)
    if step_m == 0.0:
        return depth.copy()
    return (np.rint(depth.astype(np.float64) / step_m) * step_m).astype(np.float32)


def quantise_disparity(depth: Depth, step_m: float, at_m: float) -> Depth:
    """Round the disparity (proportional to 1/z) so that depths are ``step_m`` apart at ``at_m`` [m]; steps grow as z².

    Returns:
        float32 [H, W], metres.

    Raises:
        InputError: step or reference depth is out of range.
    """
    _check_step(step_m)
    if not 0.0 < at_m <= MAX_DEPTH_M:
        raise InputError(
            f"quantisation's reference depth {at_m} m must be above 0 and at most {MAX_DEPTH_M:g}",
            code="sensor_quantisation",
        )
    if step_m == 0.0:
        return depth.copy()
    step = step_m / at_m**2
    disparity = np.divide(1.0, depth, out=np.zeros(depth.shape), where=depth > 0)
    counts = np.rint(disparity / step)
    return np.divide(1.0, counts * step, out=np.zeros(depth.shape), where=counts > 0).astype(np.float32)


def smooth_depth(depth: Depth, sigma_px: float) -> Depth:
    """Gaussian blur of standard deviation ``sigma_px`` over the readings there are; holes neither spread nor fill.

    Returns:
        float32 [H, W], metres.

    Raises:
        InputError: the deviation is out of range.
    """
    from scipy.ndimage import gaussian_filter

    if not 0.0 <= sigma_px <= 100.0:
        raise InputError(f"smoothing {sigma_px} px must be from 0 to 100", code="sensor_smoothing")
    if sigma_px == 0.0:
        return depth.copy()
    weight = (depth > 0).astype(np.float64)
    blurred = gaussian_filter(depth.astype(np.float64), sigma_px, mode="nearest", truncate=4.0)
    weights = gaussian_filter(weight, sigma_px, mode="nearest", truncate=4.0)
    return np.where(depth > 0, blurred / np.maximum(weights, 1e-12), 0.0).astype(np.float32)


def _check_step(step_m: float) -> None:
    if not 0.0 <= step_m <= 1.0:
        raise InputError(f"quantisation {step_m} m must be from 0 to 1", code="sensor_quantisation")
