"""From a capture to the network's input in one call: read, segment, register, normalise."""

from __future__ import annotations

from dataclasses import dataclass

from capture.capture_set import Capture
from capture.normalise import NetworkInput, normalise_depth
from capture.picture import Depth
from capture.register import Registration, given_registration, register
from capture.segment import ClothRegion, segment_cloth
from simcore.errors import InputError


@dataclass(frozen=True)
class PreparedCapture:
    """A capture, read and registered.

    Attributes:
        capture: the capture.
        depth: its picture [m], float32 [H, W], 0 = no data.
        region: where the cloth is in it.
        registration: the camera's pose, given or found.
        network_input: height over the panel seen by the canonical camera.
    """

    capture: Capture
    depth: Depth
    region: ClothRegion
    registration: Registration
    network_input: NetworkInput


def prepare(capture: Capture) -> PreparedCapture:
    """Read, segment, register and normalise one capture.

    Raises:
        InputError: an unusable picture, no cloth in it, or pins that do not fit the set-up; the message names the
            capture.
    """
    depth = capture.read_depth()
    try:
        region = segment_cloth(depth, capture.camera, capture.setup, capture.camera_from_panel)
        if capture.camera_from_panel is not None:
            registration = given_registration(capture.camera_from_panel)
        else:
            registration = register(depth, capture.camera, capture.setup, region)
        network_input = normalise_depth(
            depth, capture.camera, registration.camera_from_panel, capture.setup, cloth=region.mask
        )
    except InputError as error:
        raise InputError(f"capture {capture.id!r} ({capture.depth_path}): {error}", code=error.code) from None
    return PreparedCapture(capture, depth, region, registration, network_input)
