"""The network's view of a capture: height over the panel as the canonical camera would see it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from capture.holes import drop_flying_pixels, fill_small_holes, step_share
from capture.resample import View, resample
from capture.setup import DEFAULT_PIN_RADIUS_M
from renderer.camera import CANONICAL_CAMERA, Camera, frontal_pose, ray_directions
from renderer.pose import check_pose
from simcore.errors import InputError
from simcore.scenes import Scene, Setup

CANONICAL_SAMPLE_M = 0.5
"""Edge of the sample that the network knows [m]."""

CANONICAL_DISTANCE_M = float(frontal_pose()[2, 3])
"""Distance of the canonical camera from the panel [m]."""

MAX_HOLE_PX = 3
"""Half of the largest hole that is filled in the canonical picture [pixel]."""

STEP_M = 0.01
"""Heights round a hole that differ by more are of two surfaces, the farther of which goes on behind the nearer one."""

MOST_PIN_SHIFT, MOST_RADIUS_OFF, LEAST_SQUARE = 0.01, 0.0101, 0.9
"""What of a 0.5 m sample's set-up may be off before an estimate is told to be doubtful [m, m, edge over edge]; magnets
that hold a point are none."""


@dataclass(frozen=True)
class NetworkInput:
    """What the estimator sees of one capture.

    Attributes:
        height: over the panel [m], towards the camera, float32 [256, 256], seen by ``CANONICAL_CAMERA`` at
            ``frontal_pose()``; 0 where nothing is known and where there is no panel behind the cloth.
        mask: cloth or panel was seen there (or a small hole was filled), bool [256, 256].
        scene: which scene.
        length_scale: sample size over 0.5 m. All lengths were divided by it.
        otherwise: in words, how the sample is put up otherwise than nominally (:func:`put_up_otherwise`).
        pin_radius_m: what magnets hold round a corner of a 0.5 m sample.
    """

    height: NDArray[np.float32]
    mask: NDArray[np.bool_]
    scene: Scene
    length_scale: float = 1.0
    otherwise: tuple[str, ...] = ()
    pin_radius_m: float = DEFAULT_PIN_RADIUS_M


def put_up_otherwise(setup: Setup) -> tuple[str, ...]:
    """In words, what of a set-up no network was shown, which knows nominal pins of square samples before a panel alone.

    How magnets hold goes by the network (:func:`held_otherwise`).
    """
    scale = length_scale(setup)
    nominal = Setup.nominal(setup.scene, sample_size_m=setup.sample_size_m, pin_radius_m=setup.pin_radius_m)
    off = max(math.dist(place, nominal.pins_m[name]) for name, place in setup.pins_m.items())
    found = []
    if off > MOST_PIN_SHIFT * scale:
        found.append(f"pins of {setup.scene.value} are {1e3 * off:.0f} mm from the nominal ones")
    if not setup.panel:
        found.append("no panel stands behind the sample")
    if min(setup.sample_size_m) < LEAST_SQUARE * max(setup.sample_size_m):
        found.append("the sample is not square")
    return tuple(found)


def held_otherwise(one: NetworkInput, trained_m: Sequence[float]) -> str | None:
    """In words, that magnets hold the sample otherwise than a network was shown; None where they hold as one of those.

    Args:
        one: what it is to judge.
        trained_m: what magnets held round a corner in what it learnt from [m].
    """
    nearest = min(trained_m, key=lambda radius: abs(one.pin_radius_m - radius))
    if abs(one.pin_radius_m - nearest) <= MOST_RADIUS_OFF:
        return None
    held, known = (1e3 * one.length_scale * radius for radius in (one.pin_radius_m, nearest))
    return f"magnets hold {held:.0f} mm round a corner, not {known:.0f}"


def length_scale(setup: Setup) -> float:
    """The factor by which a set-up is larger than the canonical sample: its longer edge over 0.5 m.

    What is estimated on a scaled picture is converted back by :func:`trainer.targets.similarity_shift`.
    """
    scale = max(setup.sample_size_m) / CANONICAL_SAMPLE_M
    return 1.0 if abs(scale - 1.0) < 1e-9 else scale


def normalise_depth(
    depth: NDArray[np.floating],
    camera: Camera,
    camera_from_panel: ArrayLike,
    setup: Setup,
    *,
    cloth: NDArray[np.bool_] | None = None,
) -> NetworkInput:
    """Height over the panel as the canonical camera sees it.

    The picture is back-projected (lens distortion undone), moved to the panel frame, scaled to a 0.5 m sample, meshed
    over its pixel grid and drawn from the canonical camera; holes of a few pixels are filled. A picture that the
    canonical camera itself took is only turned into heights.

    Args:
        depth: z-depth [m], shape [H, W], 0 = no data.
        camera: the camera that took it.
        camera_from_panel: its pose, [4, 4].
        setup: the scene and the sample's size.
        cloth: cloth pixels, bool [H, W]; needed without a panel, when other things are in the picture: only they are
            used then. With a panel it is not needed.

    Raises:
        InputError: the picture does not fit the camera, the pose is not rigid, or nothing is where the sample should
            be (``nothing_in_view``).
    """
    pose = check_pose(camera_from_panel)
    picture = np.asarray(depth, dtype=np.float32)
    if picture.shape != (camera.height, camera.width):
        raise InputError(
            f"depth picture of shape {picture.shape} does not fit a camera of {camera.height} rows and "
            f"{camera.width} columns",
            code="depth_shape",
        )
    scale = length_scale(setup)
    if cloth is not None and not setup.panel:
        picture = np.where(cloth, picture, np.float32(0.0))
    same_view = _same_optics(camera) and scale == 1.0 and np.array_equal(pose, frontal_pose())
    seen = picture if same_view else _canonical_depth(picture, camera, pose, scale)
    known = seen > 0.0
    if not known.any():
        raise InputError(
            "nothing is seen where the sample should be: check camera_from_panel, or set it to null to have it found",
            code="nothing_in_view",
        )
    height = np.where(known, np.float32(CANONICAL_DISTANCE_M) - seen, np.float32(0.0))
    height, known = fill_holes(height, known)
    return NetworkInput(height, known, setup.scene, scale, put_up_otherwise(setup), setup.pin_radius_m / scale)


def _canonical_depth(
    depth: NDArray[np.float32], camera: Camera, pose: NDArray[np.float64], scale: float
) -> NDArray[np.float32]:
    """The picture seen by the canonical camera, all lengths divided by ``scale``; float32 [256, 256], 0 = nothing."""
    filled = fill_small_holes(drop_flying_pixels(depth, camera), camera)
    to_canonical = frontal_pose()
    rotation = to_canonical[:3, :3] @ pose[:3, :3].T / scale
    view = View(
        directions=ray_directions(camera) @ rotation.T,
        origin=to_canonical[:3, 3] - rotation @ pose[:3, 3],
        target=CANONICAL_CAMERA,
    )
    return resample(filled, view, step_share(camera))


def fill_holes(
    height: NDArray[np.float32], known: NDArray[np.bool_], unit_m: float = 1.0
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Fill holes of up to twice :data:`MAX_HOLE_PX` by the mean of what surrounds them; at a step the farther surface.

    Args:
        height: a canonical picture, float32 [256, 256].
        known: where it says something, bool, same shape.
        unit_m: of the heights [m].

    Returns:
        The filled picture, and where it says something now.
    """
    if known.all():
        return height, known
    disk = ndimage.iterate_structure(ndimage.generate_binary_structure(2, 1), MAX_HOLE_PX)
    padded = np.pad(known, MAX_HOLE_PX, mode="edge")
    closed = ndimage.binary_closing(padded, disk)[MAX_HOLE_PX:-MAX_HOLE_PX, MAX_HOLE_PX:-MAX_HOLE_PX]
    holes = closed & ~known
    if not holes.any():
        return height, known
    weight = ndimage.gaussian_filter(known.astype(np.float32), 0.7 * MAX_HOLE_PX, truncate=3.0)
    total = ndimage.gaussian_filter(np.where(known, height, np.float32(0.0)), 0.7 * MAX_HOLE_PX, truncate=3.0)
    filled = np.where(holes & (weight > 1e-6), total / np.maximum(weight, np.float32(1e-6)), height)
    _fill_behind(filled, height, known, holes, STEP_M / unit_m)
    return filled.astype(np.float32), known | (holes & (weight > 1e-6))


def _fill_behind(
    filled: NDArray[np.float32],
    height: NDArray[np.float32],
    known: NDArray[np.bool_],
    holes: NDArray[np.bool_],
    step: float,
) -> None:
    """At holes beside a step: the mean of what is known of the farther surface within reach.

    A step is a gap in the heights around; on a slope they have none.
    """
    reach = 2 * MAX_HOLE_PX
    size = 2 * reach + 1  # most holes are on flat cloth: these are passed over at once
    rise = ndimage.maximum_filter(np.where(known, height, -np.inf), size)
    rise -= ndimage.minimum_filter(np.where(known, height, np.inf), size)
    row, column = np.nonzero(holes & (rise > step))
    dy, dx = (offset.ravel() for offset in np.mgrid[-reach : reach + 1, -reach : reach + 1])
    values = np.pad(height, reach)[row[:, None] + reach + dy, column[:, None] + reach + dx].astype(np.float64)
    there = np.pad(known, reach)[row[:, None] + reach + dy, column[:, None] + reach + dx]
    low = np.where(there, values, np.inf).min(axis=1)
    high = np.where(there, values, -np.inf).max(axis=1)
    far = there & (values < 0.5 * (low + high)[:, None])
    gap = np.where(there & ~far, values, np.inf).min(axis=1) - np.where(far, values, -np.inf).max(axis=1)
    weights = far * np.exp(-0.5 * (dx**2 + dy**2) / (0.7 * MAX_HOLE_PX) ** 2)
    beside = (high - low > step) & (gap > step)
    filled[row[beside], column[beside]] = (weights * values)[beside].sum(axis=1) / weights[beside].sum(axis=1)


def _same_optics(camera: Camera) -> bool:
    """The canonical camera but for the depth unit."""
    return replace(camera, depth_unit_m=CANONICAL_CAMERA.depth_unit_m) == CANONICAL_CAMERA
