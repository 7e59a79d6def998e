"""What was found in a capture, in numbers, and what looks wrong with it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capture.camera_rig import SHIFTED
from capture.outline import expected_outline
from capture.picture import pixel_footprint_m
from capture.prepare import PreparedCapture
from capture.register import Registration
from capture.segment import ClothRegion, hole_share

MAX_NOISE_M = 0.004
MAX_HOLES = 0.4
MAX_CLOTH_SHARE = 1.3
MAX_PANEL_RMS_M = 0.006
MAX_PANEL_OFFSET_M = 0.004
MAX_PANEL_TURN_DEG = 0.4
MAX_PIN_ERROR_M = 0.015
BY_EDGES_ALONE = (
    "a stretched sample alone places the camera to 1-3 cm, and says nothing of one on its side: add a hanging picture "
    "or give the pose"
)


@dataclass(frozen=True)
class PanelReport:
    """The panel as measured, against the pose: a turned or shifted panel means a pose (or a sensor) that is off.

    Attributes:
        rms_m: of its pixels, robust: flatness and noise together.
        distance_m: of the camera from its plane.
        turned_deg: between its normal and the pose's.
        offset_m: how far it lies in front (+) of the pose's plane, in the middle of the sample.
    """

    rms_m: float
    distance_m: float
    turned_deg: float
    offset_m: float


@dataclass(frozen=True)
class CaptureReport:
    """Findings of one capture.

    Attributes:
        id, fabric, scene, repeat: of the capture.
        cloth_pixels: in the cloth's mask.
        cloth_share: area of the mask over the sample's area.
        standing_share: area that was measured in front of the panel (or on the cloth, without one), over the sample's.
        holes: share without data of the pixels where cloth is seen or should be.
        noise_m: of neighbouring pixels' depth.
        panel: None where there is none or it is hidden.
        pose: ``camera_from_panel``, found or given, rows of a 4 x 4 matrix.
        pose_from: how the pose was found (see :class:`capture.register.Registration`).
        camera_turned_deg: angle between the camera's axis and the panel's normal.
        pin_error_m: see :class:`capture.register.Registration`.
        pins_from: ``given``, ``pin_distance`` or ``nominal``.
        assumed: what the pose takes for granted.
        length_scale: the sample over a 0.5 m one.
        known_share: share of the network's picture that was seen.
        warnings: what looks wrong, in words.
    """

    id: str
    fabric: str
    scene: str
    repeat: int
    cloth_pixels: int
    cloth_share: float
    standing_share: float
    holes: float
    noise_m: float
    panel: PanelReport | None
    pose: list[list[float]]
    pose_from: str
    camera_turned_deg: float
    pin_error_m: float | None
    pins_from: str
    assumed: tuple[str, ...]
    length_scale: float
    known_share: float
    warnings: tuple[str, ...]


def report_capture(prepared: PreparedCapture) -> CaptureReport:
    """Numbers and warnings of a prepared capture."""
    capture, region, pose = prepared.capture, prepared.region, prepared.registration.camera_from_panel
    sample = capture.setup.sample_size_m[0] * capture.setup.sample_size_m[1]
    pixel = pixel_footprint_m(np.where(region.mask, prepared.depth, np.float32(0.0)), capture.camera) ** 2
    panel, holes = _panel(prepared), holes_of(prepared)
    cloth_share = float(np.count_nonzero(region.mask)) * pixel / sample
    return CaptureReport(
        id=capture.id,
        fabric=capture.fabric.id,
        scene=capture.scene.value,
        repeat=capture.repeat,
        cloth_pixels=int(np.count_nonzero(region.mask)),
        cloth_share=cloth_share,
        standing_share=float(np.count_nonzero(region.standing)) * pixel / sample,
        holes=holes,
        noise_m=region.noise_m,
        panel=panel,
        pose=pose.tolist(),
        pose_from=prepared.registration.method,
        camera_turned_deg=float(np.degrees(np.arccos(np.clip(-pose[2, 2], -1.0, 1.0)))),
        pin_error_m=prepared.registration.pin_error_m,
        pins_from=capture.pins_from,
        assumed=(*prepared.registration.assumed, *prepared.registration.unusual),
        length_scale=prepared.network_input.length_scale,
        known_share=float(prepared.network_input.mask.mean()),
        warnings=tuple(_warnings(prepared, panel, holes, cloth_share)),
    )


def _panel(prepared: PreparedCapture) -> PanelReport | None:
    plane, pose = prepared.region.plane, prepared.registration.camera_from_panel
    if plane is None:
        return None
    middle = pose[:3, :3] @ np.array([0.0, -0.5 * prepared.capture.setup.sample_size_m[1], 0.0]) + pose[:3, 3]
    return PanelReport(
        rms_m=plane.rms_m,
        distance_m=plane.distance_m,
        turned_deg=float(np.degrees(np.arccos(np.clip(plane.normal @ pose[:3, 2], -1.0, 1.0)))),
        offset_m=-float(plane.height(middle)),
    )


def _warnings(prepared: PreparedCapture, panel: PanelReport | None, holes: float, cloth_share: float) -> list[str]:
    capture, region, registration = prepared.capture, prepared.region, prepared.registration
    found = []
    if region.noise_m > MAX_NOISE_M:
        found.append(f"noise of {1e3 * region.noise_m:.1f} mm: come closer, or record more frames for the median")
    if holes > MAX_HOLES:
        found.append(f"{100 * holes:.0f} % of the cloth has no data: shade strong lights, record more frames")
    if capture.setup.panel and panel is None:
        found.append("no panel is seen: set panel to false if there is none")
    if panel is not None and panel.rms_m > max(MAX_PANEL_RMS_M, 2.0 * region.noise_m):
        found.append(f"the panel is not flat ({1e3 * panel.rms_m:.1f} mm rms)")
    if panel is not None and (panel.turned_deg > MAX_PANEL_TURN_DEG or abs(panel.offset_m) > MAX_PANEL_OFFSET_M):
        found.append(
            f"the panel is turned by {panel.turned_deg:.1f} degrees and {1e3 * panel.offset_m:+.0f} mm off the pose: "
            "correct camera_from_panel, or set it to null to have it found"
        )
    found += pose_doubts(registration)
    found += at_border(region)
    if cloth_share > MAX_CLOTH_SHARE:
        found.append(
            f"what is taken for cloth is {cloth_share:.1f} times the sample: check panel, sample_size_m and "
            "depth_unit_m"
        )
    return found


def holes_of(prepared: PreparedCapture) -> float:
    """Share of the pixels without data where cloth is seen or, before a panel that is seen, should be.

    Small holes lie in what is seen; one that sunlight makes may take half the cloth, and only the pose tells of it.
    """
    capture = prepared.capture
    if not capture.setup.panel or prepared.region.plane is None:
        return prepared.region.holes
    expected = expected_outline(capture.camera, prepared.registration.camera_from_panel, capture.setup)
    return hole_share(prepared.depth, prepared.region.mask, expected)


def pose_doubts(registration: Registration) -> list[str]:
    """In words, what speaks against a pose, or for how little it can be trusted."""
    found = [*pins_far(registration), *registration.doubts]
    if registration.method == "panel_and_edges" and SHIFTED not in found:  # which says how good it is
        found.append(BY_EDGES_ALONE)
    return found


def pins_far(registration: Registration) -> list[str]:
    """In words, pinned corners that are seen elsewhere than the set-up has them."""
    if registration.pin_error_m is None or registration.pin_error_m <= MAX_PIN_ERROR_M:
        return []
    return [f"the pinned corners are {1e3 * registration.pin_error_m:.0f} mm from the set-up's: measure pins_m again"]


def at_border(region: ClothRegion) -> list[str]:
    """In words, a sample that leaves the picture."""
    border = np.concatenate([region.standing[0], region.standing[-1], region.standing[:, 0], region.standing[:, -1]])
    return ["the cloth reaches the picture's border: take the whole sample into view"] if border.any() else []
