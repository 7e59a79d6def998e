"""Where the cloth is in a real depth picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from capture.components import surfaces
from capture.holes import fill_small_holes
from capture.outline import expected_outline
from capture.picture import Depth, pixel_footprint_m
from capture.plane import LEAST_SPREAD_M, Plane, fit_plane, refine_plane
from renderer.camera import Camera
from renderer.pose import check_pose
from simcore.errors import InputError
from simcore.scenes import Setup

PLANE_TOLERANCE_M = 0.006
"""How far a pixel may lie from a trial plane to support it: flatness of a panel and noise of a sensor [m]."""

LEAST_HEIGHT_M = 0.0015
"""Nothing lower is called cloth by its height alone [m]."""

MAX_HEIGHT_SAMPLES = 0.8
"""Nothing stands further in front of the panel than this share of the sample's size."""

MIN_STANDING_SHARE = 0.004
"""At least this share of the sample's area stands out of the panel; otherwise there is no cloth."""

_SMOOTH_PX = 1.5


@dataclass(frozen=True)
class ClothRegion:
    """What of a picture is cloth.

    Attributes:
        mask: cloth, bool [H, W]: ``standing`` and, where the pose is known, the expected outline.
        standing: pixels measured in front of the panel (with a panel) or on the cloth's own surface (without).
        plane: the panel, or None where there is none or it is hidden.
        noise_m: standard deviation of neighbouring heights, robust; the sensor's noise on that picture.
        holes: share of the cloth's pixels without data.
    """

    mask: NDArray[np.bool_]
    standing: NDArray[np.bool_]
    plane: Plane | None
    noise_m: float
    holes: float


def segment_cloth(
    depth: Depth, camera: Camera, setup: Setup, camera_from_panel: ArrayLike | None = None
) -> ClothRegion:
    """Find the cloth.

    With a panel: a robust plane is fitted and what stands in front of it by more than the noise is cloth. Cloth that
    lies on the panel (most of ``stretch``) cannot be told from it by depth: where the pose is known, the outline that
    the set-up gives is added, and ``standing`` keeps what was measured. Without a panel, or with one that is wholly
    hidden: the nearest connected surface of about the sample's size.

    Args:
        depth: z-depth [m], float32 [H, W], 0 = no data.
        camera: its camera.
        setup: the scene; ``setup.panel`` says whether a panel stands behind.
        camera_from_panel: pose, [4, 4], where known.

    Raises:
        InputError: ``cloth_not_found``.
    """
    pose = None if camera_from_panel is None else check_pose(camera_from_panel)
    noise = noise_m(depth)
    plane = find_panel(depth, camera, setup, pose) if setup.panel else None
    standing = _foreground(depth, camera, setup) if plane is None else _in_front(depth, camera, setup, plane, pose)
    mask = standing
    if pose is not None and plane is not None:
        mask = standing | (expected_outline(camera, pose, setup) & (depth > 0.0))
    return ClothRegion(mask, standing, plane, noise, hole_share(depth, mask))


def hole_share(depth: Depth, cloth: NDArray[np.bool_], expected: NDArray[np.bool_] | None = None) -> float:
    """Share without data of the pixels of the cloth, gaps of a few pixels closed, and of where it is expected.

    Args:
        depth: z-depth [m], float32 [H, W], 0 = no data.
        cloth: where it is seen, bool [H, W].
        expected: where it should be, bool [H, W]; None where that is not known.
    """
    where = ndimage.binary_closing(cloth, iterations=2) | cloth
    if expected is not None:
        where |= expected
    return float(np.mean(depth[where] == 0.0)) if where.any() else 0.0


def noise_m(depth: Depth) -> float:
    """Standard deviation of depth noise [m] from second differences along rows, robust; 0 if too little is seen."""
    known = depth > 0.0
    triple = known[:, :-2] & known[:, 1:-1] & known[:, 2:]
    second = (depth[:, :-2] - 2.0 * depth[:, 1:-1] + depth[:, 2:])[triple]
    if second.size < 100:
        return 0.0
    return float(1.4826 * np.median(np.abs(second - np.median(second))) / np.sqrt(6.0))


def find_panel(depth: Depth, camera: Camera, setup: Setup, pose: NDArray[np.float64] | None = None) -> Plane | None:
    """The panel's plane in the camera frame, or None when it is hidden.

    Planes are taken one after the other; the panel is the nearest one that faces the camera (within 45 degrees),
    reaches beyond a sample's size. Where a pose is given, the panel is looked for there first.
    """
    seen = depth > 0.0
    points = camera.back_project(depth)[seen]
    noise = noise_m(depth)
    tolerance, spread = max(PLANE_TOLERANCE_M, 4.0 * noise), max(LEAST_SPREAD_M, noise)
    if pose is not None:
        guess = refine_plane(points, pose[:3, 2], float(pose[:3, 2] @ pose[:3, 3]), 3.0 * tolerance, spread_m=spread)
        if guess.share > 0.05 and guess.rms_m < tolerance:
            return guess
    candidates: list[Plane] = []
    rest = points
    for trial in range(3):
        plane = fit_plane(rest, tolerance_m=tolerance, spread_m=spread, seed=trial)
        if plane is None:
            break
        on_it = np.abs(plane.height(rest)) < 3.0 * tolerance
        if _may_be_panel(plane, rest[on_it], setup):
            candidates.append(plane)
        rest = rest[~on_it]
        if len(rest) < 0.1 * len(points):
            break
    return min(candidates, key=lambda plane: plane.distance_m, default=None)


def _may_be_panel(plane: Plane, members: NDArray[np.float64], setup: Setup) -> bool:
    if plane.normal[2] > -np.cos(np.radians(45.0)):
        return False
    size = np.percentile(members, 98, axis=0) - np.percentile(members, 2, axis=0)
    return bool(np.any(size[:2] > 1.1 * np.asarray(setup.sample_size_m)))


def _in_front(
    depth: Depth, camera: Camera, setup: Setup, plane: Plane, pose: NDArray[np.float64] | None
) -> NDArray[np.bool_]:
    """Pixels in front of the panel by more than the noise, in pieces that are not specks; bool [H, W]."""
    seen = depth > 0.0
    points = camera.back_project(fill_small_holes(depth, camera))
    height = np.nan_to_num(plane.height(points), nan=0.0)
    size = max(setup.sample_size_m)
    possible = np.isfinite(points[..., 2]) & (height < MAX_HEIGHT_SAMPLES * size)
    if pose is not None:
        panel = (points - pose[:3, 3]) @ pose[:3, :3]
        with np.errstate(invalid="ignore"):
            possible &= np.all(np.abs(panel[..., :2] - (0.0, -0.5 * size)) < 0.75 * size, axis=-1)
    weight = ndimage.gaussian_filter(possible.astype(np.float64), _SMOOTH_PX)
    smooth = ndimage.gaussian_filter(np.where(possible, height, 0.0), _SMOOTH_PX) / np.maximum(weight, 1e-3)
    on_panel = smooth[seen & (np.abs(height) < 3.0 * max(plane.rms_m, 1e-4))]
    spread = 1.4826 * float(np.median(np.abs(on_panel - np.median(on_panel)))) if on_panel.size > 100 else 0.0
    low, high = max(LEAST_HEIGHT_M, 4.0 * spread), max(2.0 * LEAST_HEIGHT_M, 8.0 * spread)
    # Smoothing carries a step's height beyond the step; a median does not.
    raised = possible & (smooth > low) & (ndimage.median_filter(height, 3) > 0.4 * smooth)
    labels, count = ndimage.label(raised)
    footprint = pixel_footprint_m(depth, camera)
    area = np.bincount(labels.ravel(), minlength=count + 1) * footprint**2
    highest = ndimage.maximum(smooth, labels, index=np.arange(count + 1)) if count else np.zeros(1)
    good = (area > 0.0005 * size**2) & (np.asarray(highest) > high)
    good[0] = False
    standing: NDArray[np.bool_] = good[labels] & seen
    if standing.sum() * footprint**2 < MIN_STANDING_SHARE * setup.sample_size_m[0] * setup.sample_size_m[1]:
        raise InputError(
            "no cloth is seen: nothing stands out of the panel. Check that the sample is in the picture, that panel is "
            "true only if there is one, and depth_unit_m",
            code="cloth_not_found",
        )
    return standing


def _foreground(depth: Depth, camera: Camera, setup: Setup) -> NDArray[np.bool_]:
    """The nearest connected surface of about the sample's size, bool [H, W]."""
    filled = fill_small_holes(depth, camera)
    labels, count = surfaces(filled, camera)
    points = camera.back_project(filled)
    width, height = setup.sample_size_m
    footprint = pixel_footprint_m(depth, camera)
    best, best_distance, seen_sizes = 0, np.inf, []
    pixels = np.bincount(labels.ravel(), minlength=count + 1)
    for label in np.argsort(-pixels):
        if label == 0 or pixels[label] * footprint**2 < 0.02 * width * height:
            continue
        member = points[labels == label]
        low, high = np.percentile(member, 1, axis=0), np.percentile(member, 99, axis=0)
        across, down = (high - low)[:2]
        seen_sizes.append(f"{across:.2f} x {down:.2f} m")
        fits = any(  # the camera may be on its side
            0.3 * a < across < 1.5 * a + 0.1 and 0.3 * b < down < 1.5 * b + 0.1
            for a, b in ((width, height), (height, width))
        )
        distance = float(np.median(member[:, 2]))
        if fits and distance < best_distance:
            best, best_distance = int(label), distance
    if not best:
        found = f"surfaces seen: {', '.join(seen_sizes[:4])}" if seen_sizes else "no surface of that size is seen"
        raise InputError(
            f"no cloth of about {width:g} x {height:g} m is seen ({found}): check sample_size_m, depth_unit_m and that "
            "nothing stands before the sample",
            code="cloth_not_found",
        )
    mask: NDArray[np.bool_] = (labels == best) & (depth > 0.0)
    return mask
