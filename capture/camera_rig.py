"""One camera that does not move between captures: what all of them say of its pose, put together."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from capture.plane import Plane
from capture.register import Registration
from simcore.errors import InputError
from simcore.scenes import Scene

MAX_SPREAD_M = 0.015
"""Poses further apart than this [m] are not of one fixed camera."""

MAX_SPREAD_RAD = float(np.radians(2.0))
"""Poses turned against each other by more than this are not of one fixed camera."""

MAX_SHIFT_M = 0.045
"""Edges of a stretched sample that lie further along the panel [m] from where the others' pose has them were seen from
elsewhere. They are found to 1 to 3 cm: as the open sets were taken, 36 mm from it at most."""

ELSEWHERE = "the camera stood elsewhere than for the captures that gave the others' pose: so its picture says"
AT_ODDS = "the pictures do not give one pose of one camera: each keeps its own"
SHIFTED = (
    "the sample's edges lie elsewhere on the panel than the others' pose has them, as where the camera was moved: its "
    "own pose, good to 1-3 cm, was taken; leave camera and magnets where they are and take the pictures again, or "
    "state camera_from_panel"
)
NO_POSE = "its own picture gives no pose: it has that of the others"


def common_pose(poses: Sequence[NDArray[np.float64]]) -> NDArray[np.float64] | None:
    """Median position and mean rotation of several estimates of one pose, or None where they do not agree.

    Args:
        poses: ``camera_from_panel``, each [4, 4].

    Returns:
        float64 [4, 4], or None: fewer than half lie within :data:`MAX_SPREAD_M` and :data:`MAX_SPREAD_RAD` of the
        middle, so that the camera has moved, or some estimate is badly wrong.
    """
    from scipy.spatial.transform import Rotation

    stack = np.stack(poses)
    middle = np.median(stack[:, :3, 3], axis=0)
    rotations = Rotation.from_matrix(stack[:, :3, :3])
    near = np.linalg.norm(stack[:, :3, 3] - middle, axis=1) < MAX_SPREAD_M
    if near.any():
        near &= (rotations[near].mean().inv() * rotations).magnitude() < MAX_SPREAD_RAD
    if np.count_nonzero(near) * 2 <= len(poses):
        return None
    pose = np.eye(4)
    pose[:3, :3] = rotations[near].mean().as_matrix()
    pose[:3, 3] = np.median(stack[near, :3, 3], axis=0)
    return pose


def share_pose(
    scenes: Sequence[Scene], alone: Sequence[Callable[[], Registration]], planes: Sequence[Plane | None]
) -> list[Registration]:
    """Register the captures of one camera, which stood still unless they say otherwise.

    ``hanging`` pictures show the pinned corners clearly, ``stretch`` pictures do not: where there are both, the pose
    comes from the hanging ones. Where the estimates do not agree, each capture keeps its own; where most do, one keeps
    its own that is far from them and fits its pins, or whose panel is not where their pose has it, or, of ``stretch``
    pictures that go by ``hanging`` ones, whose edges are not: the camera stood elsewhere for it.

    Args:
        scenes: of the captures.
        alone: for each capture, what registers it by itself; called only where it is needed.
        planes: for each capture, the panel as its picture shows it; None where none is seen.

    Raises:
        InputError: a capture cannot be registered and there is no common pose, or it is not of that one.
    """
    own = [cache(one) for one in alone]
    hanging = [i for i, scene in enumerate(scenes) if scene is Scene.HANGING]
    votes: dict[int, Registration] = {}
    failures: dict[int, InputError] = {}
    for i in hanging or range(len(scenes)):
        try:
            votes[i] = own[i]()
        except InputError as error:
            failures[i] = error
    pose = common_pose([vote.camera_from_panel for vote in votes.values()]) if len(scenes) > 1 and votes else None
    if pose is None:
        if failures:
            raise next(iter(failures.values()))
        kept = [one() for one in own]
        return kept if len(kept) < 2 else [_noted(one, AT_ODDS) for one in kept]
    apart = {i: ELSEWHERE for i, vote in votes.items() if not _near(vote.camera_from_panel, pose) and _fits(vote)}
    seen = {i: plane for i, plane in enumerate(planes) if plane is not None}
    apart |= {i: ELSEWHERE for i, plane in seen.items() if not _on_panel(plane, pose)}
    by_edges = [i for i in seen if scenes[i] is Scene.STRETCH and i not in apart and i not in votes]
    apart |= {i: SHIFTED for i in by_edges if _edges_elsewhere(own[i], pose)}
    agreeing = sum(_near(vote.camera_from_panel, pose) for vote in votes.values())
    still = f"the camera stood still over {len(scenes) - len(apart)} captures; {agreeing} gave its pose"
    example = replace(next(iter(votes.values())), pin_error_m=None, unusual=())
    shared = []
    for i in range(len(scenes)):
        if i in apart:
            if i in failures:
                raise failures[i]
            shared.append(_noted(own[i](), apart[i]))
            continue
        one = votes.get(i, example)
        one = replace(one, camera_from_panel=pose, assumed=(*one.assumed, still))
        shared.append(_noted(one, NO_POSE) if i in failures else one)
    return shared


def _noted(one: Registration, note: str) -> Registration:
    return replace(one, unusual=(*one.unusual, note))


def _on_panel(plane: Plane, pose: NDArray[np.float64]) -> bool:
    """Whether a panel as a picture shows it may be the one that a pose [4, 4] has before the camera."""
    turned = np.arccos(np.clip(plane.normal @ pose[:3, 2], -1.0, 1.0))
    return bool(abs(plane.height(pose[:3, 3])) < MAX_SPREAD_M and turned < MAX_SPREAD_RAD)


def _edges_elsewhere(alone: Callable[[], Registration], pose: NDArray[np.float64]) -> bool:
    """Whether a stretched sample's edges, as ``alone`` finds them, lie further along the panel than
    :data:`MAX_SHIFT_M` from where a pose [4, 4] has them; edges that are not found say nothing."""
    try:
        found = alone().camera_from_panel
    except InputError:
        return False
    right, up = (found[:3, 3] - pose[:3, 3]) @ pose[:3, :2]
    return math.hypot(right, up) > MAX_SHIFT_M


def _near(a: NDArray[np.float64], b: NDArray[np.float64]) -> bool:
    """Whether two poses [4, 4] may be of one fixed camera."""
    turned = np.arccos(np.clip(0.5 * (np.trace(a[:3, :3].T @ b[:3, :3]) - 1.0), -1.0, 1.0))
    return bool(np.linalg.norm(a[:3, 3] - b[:3, 3]) < MAX_SPREAD_M and turned < MAX_SPREAD_RAD)


def _fits(vote: Registration) -> bool:
    return vote.pin_error_m is not None and vote.pin_error_m < MAX_SPREAD_M
