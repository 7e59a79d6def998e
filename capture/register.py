"""The camera's pose against the panel, found from one depth picture where it is not given."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from capture.edges import align_edges
from capture.holes import fill_small_holes, step_share
from capture.picture import Depth
from capture.plane import Plane
from capture.segment import ClothRegion
from renderer.camera import Camera
from renderer.pose import check_pose, invert_pose
from simcore.errors import InputError
from simcore.scenes import PIN_NAMES, Scene, Setup

MAX_PIN_ERROR = 0.2
"""Pins found further from where they should be than this share of the sample's size are no registration."""

UNSEEN_CORNER_M = 0.003
"""How far below a pin the cloth begins to stand out of the panel, on average over simulated and open captures [m]."""

SUSPECT, TURNED_SHARE = 0.03, 0.4
"""Where hanging corners lie further from the pins than this share of the sample's size, a camera on its side or upside
down is thought of; it is taken for one where that leaves less than this share."""
_UPRIGHT = np.array([0.0, -1.0, 0.0])
_ON_A_SIDE = tuple(np.array(up) for up in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0)))
"""Where the sample's top may lie, in the camera's frame."""

_OUTERMOST = 12
_FAR = 2.5
"""Of these, one further from their middle than so many times the median of them is none of the corner's."""

_DIRECTIONS: dict[str, tuple[float, float]] = {
    "top_left": (-1.0, 1.0),
    "top_right": (1.0, 1.0),
    "bottom_right": (1.0, -1.0),
}
HIDDEN = "the panel is hidden: its plane passes through the pins"
"""What is unusual of a registration, and no doubt of its pose."""


@dataclass(frozen=True)
class Registration:
    """A camera's pose and how far it can be trusted.

    Attributes:
        camera_from_panel: float64 [4, 4].
        method: ``given``, ``panel_and_pins`` (hanging, panel seen), ``panel_and_edges`` (stretch, panel seen),
            ``hanging_pins`` or ``three_pins`` (no panel seen).
        pin_error_m: root mean square distance between the corners as seen and the pins of the set-up; None where the
            pose did not come from this picture's corners.
        assumed: what was taken for granted, in words.
        unusual: what of it is out of the ordinary, in words.
    """

    camera_from_panel: NDArray[np.float64]
    method: str
    pin_error_m: float | None
    assumed: tuple[str, ...]
    unusual: tuple[str, ...] = ()

    @property
    def doubts(self) -> tuple[str, ...]:
        """What is unusual and speaks against the pose: a panel that is hidden does not."""
        return tuple(note for note in self.unusual if note != HIDDEN)


def given_registration(camera_from_panel: NDArray[np.float64]) -> Registration:
    """The pose that a capture set states, taken as it is."""
    return Registration(check_pose(camera_from_panel), "given", None, ("the pose that the set states is right",))


def register(depth: Depth, camera: Camera, setup: Setup, region: ClothRegion) -> Registration:
    """Estimate ``camera_from_panel``.

    With a panel in view, its plane gives z; the pinned corners (``hanging``) or the steps along the sample's edges
    (``stretch``) give the rest. Without, in ``hanging``, the line through
    the two pinned corners gives x, and down is where the cloth's centre of mass hangs below that line (what hangs at
    rest from a level axis has its weight straight below it); in ``stretch`` the three pinned corners give the pose.

    Args:
        depth: z-depth [m], float32 [H, W], 0 = no data.
        camera: its camera.
        setup: the scene and its pins.
        region: the cloth, from :func:`capture.segment.segment_cloth`.

    Raises:
        InputError: ``pins_not_found``: the corners seen do not fit the set-up.
    """
    filled = fill_small_holes(depth, camera)
    whole = ndimage.binary_closing(np.pad(region.standing, 4), iterations=3)[4:-4, 4:-4] & (filled > 0.0)
    points = camera.back_project(filled)[whole | region.standing]
    found = _register(depth, camera, setup, region, points, _UPRIGHT)
    suspect = SUSPECT * max(setup.sample_size_m)
    if found.pin_error_m is not None and setup.scene is Scene.HANGING and found.pin_error_m > suspect:
        found = _turned(found, [_register(depth, camera, setup, region, points, up) for up in _ON_A_SIDE])
    if found.pin_error_m is not None and found.pin_error_m > MAX_PIN_ERROR * max(setup.sample_size_m):
        raise InputError(
            f"the pinned corners are seen {1e3 * found.pin_error_m:.0f} mm from where the set-up has them: check "
            "scene, sample_size_m and pins_m, or give camera_from_panel",
            code="pins_not_found",
        )
    return found


def _turned(upright: Registration, others: list[Registration]) -> Registration:
    """The registration of a camera on its side or upside down, where that alone fits the pins."""
    best = min(others, key=_pin_error)
    if _pin_error(best) > TURNED_SHARE * _pin_error(upright):
        return upright
    return replace(best, unusual=(*best.unusual, "the camera is on its side or upside down: so its picture fits"))


def _pin_error(found: Registration) -> float:
    return math.inf if found.pin_error_m is None else found.pin_error_m


def _register(
    depth: Depth,
    camera: Camera,
    setup: Setup,
    region: ClothRegion,
    points: NDArray[np.float64],
    up: NDArray[np.float64],
) -> Registration:
    """Registration by the cloth's points [N, 3] of a picture whose direction ``up`` [3] is the sample's, about."""
    frame = _first_frame(points, region.plane, up)
    corners = _corners(points, frame, setup.scene)
    expected = {name: np.asarray(setup.pins_m[name], dtype=np.float64) for name in PIN_NAMES[setup.scene]}
    if region.plane is not None and setup.scene is Scene.STRETCH:
        middle = 0.5 * (corners["top_left"] + corners["top_right"])
        middle -= region.plane.height(middle) * region.plane.normal
        pose, method = align_edges(depth, camera, setup, region.plane, frame, middle), "panel_and_edges"
        # edges are right to 1 cm in most pictures, 3 in some
        assumed = ["the sample's edges run straight between its pins", "the picture's top is the sample's"]
    elif region.plane is not None:
        pose, method = _panel_pose(corners, expected, region.plane), "panel_and_pins"
        assumed = ["the cloth's outermost visible corners are the pinned ones"]
    elif setup.scene is Scene.HANGING:
        pose = _hanging_pose(corners, expected, _centre_of_mass(depth, camera, region))
        method = "hanging_pins"
        assumed = ["the two pins are level", "the cloth hangs free and at rest, its weight below the pins"]
    else:
        pose, method = rigid_fit(list(expected.values()), list(corners.values())), "three_pins"
        assumed = [
            "the three outermost corners of the cloth are the pinned ones",
            "the picture's top is the sample's",
        ]
    if method == "panel_and_edges":  # the corners did not count: their cloth lies too close to the panel to be seen
        return Registration(pose, method, None, tuple(assumed))
    hidden = setup.panel and region.plane is None
    unusual = (HIDDEN,) if hidden else ()
    inverse = invert_pose(pose)
    found = {name: inverse[:3, :3] @ corner + inverse[:3, 3] for name, corner in corners.items()}
    error = float(np.sqrt(np.mean([np.sum((found[name] - expected[name]) ** 2) for name in found])))
    return Registration(pose, method, error, tuple(assumed), unusual)


def _first_frame(points: NDArray[np.float64], plane: Plane | None, up: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows x, y, z of a first panel frame: z from the panel or the cloth, y along ``up``; float64 [3, 3]."""
    if plane is not None:
        z = plane.normal
    else:
        centred = points - points.mean(axis=0)
        z = np.linalg.eigh(centred.T @ centred)[1][:, 0]
        z = -z if z[2] > 0.0 else z
        if z[2] > -0.5:  # a sheet seen edge on says nothing of the panel
            z = np.array([0.0, 0.0, -1.0])
    y = up - (up @ z) * z
    y /= np.linalg.norm(y)
    return np.stack([np.cross(y, z), y, z])


def _corners(points: NDArray[np.float64], frame: NDArray[np.float64], scene: Scene) -> dict[str, NDArray[np.float64]]:
    """The pinned corners of the cloth: the points furthest out along the diagonals, camera frame.

    Of the few outermost points the height is the most extreme one's and the rest their median: next to a pin the cloth
    leaves the panel slowly sideways and steeply downwards, and flying pixels must not count. Nor must one far from all
    the others: a pixel of the panel beside the cloth's rim, which the holes round it let pass for cloth.
    """
    x, y = points @ frame[0], points @ frame[1]
    corners = {}
    for name in PIN_NAMES[scene]:
        right, up = _DIRECTIONS[name]
        outermost = np.argsort(right * x + up * y)[-_OUTERMOST:]
        away = np.hypot(x[outermost] - np.median(x[outermost]), y[outermost] - np.median(y[outermost]))
        outermost = outermost[away <= _FAR * np.median(away)]
        middle = np.median(points[outermost], axis=0)
        corners[name] = middle + (up * np.max(up * y[outermost]) - middle @ frame[1]) * frame[1]
    return corners


def _panel_pose(
    corners: dict[str, NDArray[np.float64]], expected: dict[str, NDArray[np.float64]], plane: Plane
) -> NDArray[np.float64]:
    """Pose from the panel's plane and the corners' places on it.

    Right at a pin the cloth does not stand out of the panel: the corners seen lie a little below the pins.
    """
    z = plane.normal
    left, right = (corners[name] - plane.height(corners[name]) * z for name in ("top_left", "top_right"))
    on_panel = [expected[name] * (1.0, 1.0, 0.0) for name in ("top_left", "top_right")]
    pose = rigid_fit(on_panel, [left, right], normal=z)
    pose[:3, 3] += UNSEEN_CORNER_M * pose[:3, 1]
    return pose


def rigid_fit(
    source: list[NDArray[np.float64]], target: list[NDArray[np.float64]], normal: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """Rotation and translation that bring points to points in the least-squares sense (Kabsch 1976), float64 [4, 4].

    Args:
        source: in the panel frame, as many as ``target``.
        target: in the camera frame.
        normal: the panel's normal in the camera frame, kept exactly: two points are enough then.
    """
    a, b = np.asarray(source), np.asarray(target)
    a_mean, b_mean = a.mean(axis=0), b.mean(axis=0)
    covariance = (b - b_mean).T @ (a - a_mean)
    if normal is not None:
        covariance = covariance + 1e6 * np.outer(normal, (0.0, 0.0, 1.0))
    u, _, vt = np.linalg.svd(covariance)
    rotation = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = b_mean - rotation @ a_mean
    return pose


def _hanging_pose(
    corners: dict[str, NDArray[np.float64]], expected: dict[str, NDArray[np.float64]], centre: NDArray[np.float64]
) -> NDArray[np.float64]:
    """x along the pins, turned back by what the set-up turns them, the centre of mass straight below them."""
    left, right = corners["top_left"], corners["top_right"]
    across = expected["top_right"] - expected["top_left"]
    x = (right - left) / np.linalg.norm(right - left)
    middle = 0.5 * (left + right)
    down = (centre - middle) - ((centre - middle) @ x) * x
    y = -down / np.linalg.norm(down)
    length = math.hypot(across[0], across[1])
    cos, sin = across[0] / length, across[1] / length
    x, y = cos * x - sin * y, sin * x + cos * y
    rotation = np.stack([x, y, np.cross(x, y)], axis=1)
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = middle - rotation @ (0.5 * (expected["top_left"] + expected["top_right"]))
    return pose


def _centre_of_mass(depth: Depth, camera: Camera, region: ClothRegion) -> NDArray[np.float64]:
    """Centre of mass of the visible cloth, of even density, camera frame, float64 [3]: every triangle by its area."""
    filled = fill_small_holes(np.where(region.standing, depth, np.float32(0.0)), camera)
    points = camera.back_project(filled)
    a, b, c, d = points[:-1, :-1], points[:-1, 1:], points[1:, :-1], points[1:, 1:]
    centres, areas = [], []
    for p, q, r in ((a, c, b), (b, c, d)):
        steps = np.ptp(np.stack([p[..., 2], q[..., 2], r[..., 2]]), axis=0)
        joined = steps < step_share(camera) * r[..., 2]  # NaN compares as false
        areas.append(0.5 * np.linalg.norm(np.cross(q[joined] - p[joined], r[joined] - p[joined]), axis=1))
        centres.append((p[joined] + q[joined] + r[joined]) / 3.0)
    weights = np.concatenate(areas)
    centre: NDArray[np.float64] = np.average(np.concatenate(centres), axis=0, weights=weights)
    return centre
