"""Whether a capture shows enough of the cloth to be compared with a simulation; what does not is refused."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from diagnosis.measurement.features import Features
from diagnosis.measurement.reference import CELLS, LEAST_PIXELS, Reference
from diagnosis.scene import SimulationScene
from renderer.depth import panel_depth
from simcore.errors import InputError

LEAST_PARTS = CELLS * CELLS // 2
"""Cells of the cloth that a capture must show; usual pictures of 640 x 480 show all 144."""
MOST_PARTS = CELLS * CELLS * 9 // 10
"""From here on nothing is said of those that are missing."""


def check_kept(
    capture_id: str,
    depth: NDArray[np.float32],
    kept: NDArray[np.float32],
    scene: SimulationScene,
    *,
    pose_stated: bool,
) -> None:
    """Refuse a picture of which nearly nothing lies where cloth and panel should be, before simulating.

    Args:
        capture_id: for the message.
        depth: the picture [m], float32 [H, W].
        kept: what is compared of it, 0 elsewhere.
        scene: how the camera sees the panel.
        pose_stated: the set states the camera's pose; otherwise it was found in the set's pictures.

    Raises:
        InputError: naming the capture.
    """
    least = LEAST_PARTS * LEAST_PIXELS
    if np.count_nonzero(kept) >= least:
        return
    panel = panel_depth(scene.camera, scene.camera_from_panel)
    both = (depth > 0) & (panel > 0)
    if np.count_nonzero(both) < least or not scene.setup.panel:
        raise InputError(
            f"capture {capture_id}: {np.count_nonzero(kept)} pixels show the cloth or what is round it, {least} are "
            "the least: take it again with more pixels on the cloth, or leave it out",
            code="cloth_not_seen",
        )
    off = float(np.median(depth[both] - panel[both]))
    where = f"{abs(off):.2g} m {'behind' if off > 0 else 'before'} the panel"
    if pose_stated:
        said = (
            f"{where} that is stated: correct camera_from_panel, depth_unit_m or the picture, or leave the capture out"
        )
    else:
        said = (
            f"{where} as it was found in the set's pictures: give camera_from_panel (the capture's own, where the "
            "camera stood elsewhere for it), correct depth_unit_m or the picture, or leave the capture out"
        )
    raise InputError(f"capture {capture_id}: what it shows lies {said}", code="cloth_not_seen")


def check_seen(capture_id: str, measured: Features, reference: Reference) -> None:
    """Refuse a capture that shows less than half of the cloth's cells.

    Args:
        capture_id: for the message.
        measured: of its picture against ``reference``.
        reference: the simulated picture and its cells.

    Raises:
        InputError: naming the capture.
    """
    shown = _shown(measured, reference)
    if shown >= LEAST_PARTS:
        return
    visible = int((np.bincount(reference.cell[reference.cell >= 0], minlength=1)[: CELLS**2] >= LEAST_PIXELS).sum())
    said = f"capture {capture_id}: {shown} of {CELLS**2} parts of the cloth are seen by {LEAST_PIXELS} pixels or more"
    if visible < LEAST_PARTS:
        raise InputError(
            f"{said}, and the stated camera could see no more than {visible}: take pictures with more pixels on the "
            "cloth, or correct camera and camera_from_panel",
            code="cloth_not_seen",
        )
    raise InputError(
        f"{said}, the stated camera should see {visible}: the others are holes in the picture, or cloth and pose are "
        "elsewhere than stated; take it again, or leave it out",
        code="cloth_not_seen",
    )


def partly_seen(captures: Mapping[str, tuple[Features, Reference]]) -> Iterator[str]:
    """In words, captures (by id) that show less of the cloth than usual."""
    for capture_id, (measured, reference) in captures.items():
        shown = _shown(measured, reference)
        if shown < MOST_PARTS:
            yield f"capture {capture_id}: {shown} of {CELLS**2} parts of the cloth are seen well enough to be compared"


def _shown(measured: Features, reference: Reference) -> int:
    return int((measured.weight[: CELLS**2] >= reference.least_pixels).sum())
