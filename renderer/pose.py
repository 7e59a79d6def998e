"""Rigid transforms between the panel, the camera and an inclined sample; float64 [4, 4], metres."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simcore.errors import InputError

INCLINATIONS_DEG: tuple[float, ...] = tuple(float(degree) for degree in range(-5, 6))
"""The eleven inclinations of the paper's simulation-space augmentation [degree]."""

MAX_INCLINATION_DEG = 45.0
ROUNDED = 5e-3
"""What is left of a rotation whose numbers were kept with three decimals is orthonormal within this."""


def check_pose(pose: ArrayLike, name: str = "camera_from_panel") -> NDArray[np.float64]:
    """``pose`` as float64 [4, 4].

    Raises:
        InputError: not a rigid transform (rotation orthonormal within 1e-4, right-handed, last row 0 0 0 1).
    """
    matrix = np.asarray(pose, dtype=np.float64)
    if matrix.shape != (4, 4) or not np.all(np.isfinite(matrix)):
        raise InputError(f"{name} must be 4 x 4 finite numbers, got shape {matrix.shape}", code="pose")
    rotation = matrix[:3, :3]
    rigid = np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-4) and np.linalg.det(rotation) > 0.0
    if not rigid or not np.allclose(matrix[3], (0.0, 0.0, 0.0, 1.0), atol=1e-9):
        raise InputError(f"{name} must be a rotation and a translation (last row 0 0 0 1)", code="pose")
    return matrix


def nearest_pose(pose: ArrayLike, name: str = "camera_from_panel") -> NDArray[np.float64]:
    """The rigid transform that a document states, float64 [4, 4], however its numbers were rounded.

    A rotation that is orthonormal within 1e-6 is taken as it is, one that is so within :data:`ROUNDED` is replaced by
    the nearest one (by singular values).

    Raises:
        InputError: it is no rigid transform.
    """
    matrix = np.array(pose, dtype=np.float64)
    if matrix.shape == (4, 4) and np.all(np.isfinite(matrix)):
        off = float(np.abs(matrix[:3, :3] @ matrix[:3, :3].T - np.eye(3)).max())
        if 1e-6 < off < ROUNDED:
            left, _, right = np.linalg.svd(matrix[:3, :3])
            matrix[:3, :3] = left @ right
    return check_pose(matrix, name)


def invert_pose(pose: ArrayLike) -> NDArray[np.float64]:
    """Inverse of a rigid transform, float64 [4, 4]."""
    matrix = check_pose(pose, "pose")
    inverse = np.eye(4)
    inverse[:3, :3] = matrix[:3, :3].T
    inverse[:3, 3] = -matrix[:3, :3].T @ matrix[:3, 3]
    return inverse


def transform_points(pose: ArrayLike, points: ArrayLike) -> NDArray[np.float64]:
    """Points, shape [..., 3], moved by a rigid transform, float64."""
    matrix = np.asarray(pose, dtype=np.float64)
    return np.asarray(points, dtype=np.float64) @ matrix[:3, :3].T + matrix[:3, 3]


def pose_from_rotation(
    rotation_vector: ArrayLike = (0.0, 0.0, 0.0), translation: ArrayLike = (0.0, 0.0, 0.0)
) -> NDArray[np.float64]:
    """Rigid transform from a rotation vector (axis times angle [rad], Rodrigues) and a translation [m]."""
    from scipy.spatial.transform import Rotation

    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(np.asarray(rotation_vector, dtype=np.float64)).as_matrix()
    pose[:3, 3] = np.asarray(translation, dtype=np.float64)
    return check_pose(pose, "pose")


def inclination_pose(inclination_deg: float) -> NDArray[np.float64]:
    """``panel_from_inclined``: turns the sample about the horizontal x axis through its top pins (y = z = 0).

    Positive brings the hem towards the camera (+z), negative takes it away. The paper renders the "simulated meshes
    within a range of different inclinations with respect to the vertical plane", +-5 degrees in 11 steps
    (:data:`INCLINATIONS_DEG`): it is the view that varies, gravity and the drape do not.

    Raises:
        InputError: beyond +-45 degrees or not finite.
    """
    if not abs(inclination_deg) <= MAX_INCLINATION_DEG:
        raise InputError(
            f"inclination {inclination_deg} degrees must be from -{MAX_INCLINATION_DEG:g} to {MAX_INCLINATION_DEG:g}",
            code="inclination",
        )
    angle = -math.radians(inclination_deg)
    cosine, sine = math.cos(angle), math.sin(angle)
    return np.array([[1.0, 0.0, 0.0, 0.0], [0.0, cosine, -sine, 0.0], [0.0, sine, cosine, 0.0], [0.0, 0.0, 0.0, 1.0]])
