"""From a capture to the network's input in one call: read, segment, register, normalise."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

from capture.camera_rig import share_pose
from capture.capture_set import Capture
from capture.normalise import NetworkInput, normalise_depth
from capture.picture import Depth
from capture.register import Registration, given_registration, register
from capture.segment import ClothRegion, segment_cloth
from renderer.camera import Camera
from simcore.errors import InputError
from simcore.scenes import Scene


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
    """Read, segment, register and normalise one capture by itself.

    Raises:
        InputError: an unusable picture, no cloth in it, or pins that do not fit the set-up; the message names the
            capture.
    """
    return next(prepare_all([capture]))


def _refuse(capture: Capture, error: InputError) -> None:
    raise error


def prepare_all(
    captures: Sequence[Capture], on_no_cloth: Callable[[Capture, InputError], None] = _refuse
) -> Iterator[PreparedCapture]:
    """Read, segment, register and normalise captures, in their order.

    Captures without a pose that share a camera and the size of their sample are taken to be of one camera that stood
    still (see :func:`capture.camera_rig.share_pose`), unless they say otherwise: where their own ``setup`` speaks of
    ``camera_from_panel``, they are registered by themselves.

    Args:
        captures: to prepare.
        on_no_cloth: told of a capture in which no cloth is seen, and why; if it returns, that one is passed over.

    Raises:
        InputError: as :func:`prepare`; all captures are registered before the first is handed out.
    """
    captures, regions = _seen(captures, on_no_cloth)
    registrations: dict[int, Registration] = {}

    for group in _same_camera(captures):
        alone = [partial(_register, captures[i], regions[i]) for i in group]
        shared = share_pose([captures[i].scene for i in group], alone, [regions[i].plane for i in group])
        registrations |= dict(zip(group, shared, strict=True))
    for index in range(len(captures)):
        if index not in registrations:
            registrations[index] = _register(captures[index], regions[index])
    return (
        _finish(capture, region, registrations[index])
        for index, (capture, region) in enumerate(zip(captures, regions, strict=True))
    )


def inputs_by_fabric(prepared: Iterable[PreparedCapture]) -> dict[str, dict[Scene | str, list[NetworkInput]]]:
    """What the network sees of each fabric (by id), by scene, in the captures' order."""
    found: dict[str, dict[Scene | str, list[NetworkInput]]] = {}
    for one in prepared:
        found.setdefault(one.capture.fabric.id, {}).setdefault(one.capture.scene, []).append(one.network_input)
    return found


def _seen(
    captures: Sequence[Capture], on_no_cloth: Callable[[Capture, InputError], None]
) -> tuple[list[Capture], list[ClothRegion]]:
    """Captures that show cloth, and where."""
    seen, regions = [], []
    for capture in captures:
        try:
            region = _find_cloth(capture)
        except InputError as error:
            if error.code != "cloth_not_found":
                raise
            on_no_cloth(capture, error)
            continue
        seen.append(capture)
        regions.append(region)
    return seen, regions


def _find_cloth(capture: Capture) -> ClothRegion:
    depth = capture.read_depth()
    try:
        return segment_cloth(depth, capture.camera, capture.setup, capture.camera_from_panel)
    except InputError as error:
        raise _named(capture, error) from None


def _register(capture: Capture, region: ClothRegion) -> Registration:
    if capture.camera_from_panel is not None:
        return given_registration(capture.camera_from_panel)
    try:
        return register(capture.read_depth(), capture.camera, capture.setup, region)
    except InputError as error:
        raise _named(capture, error) from None


def _finish(capture: Capture, region: ClothRegion, registration: Registration) -> PreparedCapture:
    depth, pose = capture.read_depth(), registration.camera_from_panel
    try:
        network_input = normalise_depth(depth, capture.camera, pose, capture.setup, cloth=region.mask)
    except InputError as error:
        raise _named(capture, error) from None
    return PreparedCapture(capture, depth, region, registration, network_input)


def _same_camera(captures: Sequence[Capture]) -> list[list[int]]:
    """Indices of captures without a pose, grouped by camera and sample; those with their own word on it stay apart.

    A pose is told from where the magnets are, and samples of another size hang from others.
    """
    groups: dict[tuple[Camera, tuple[float, float]], list[int]] = {}
    for index, capture in enumerate(captures):
        own = capture.document.setup is not None and "camera_from_panel" in capture.document.setup.model_fields_set
        if capture.camera_from_panel is None and not own:
            groups.setdefault((capture.camera, capture.setup.sample_size_m), []).append(index)
    return list(groups.values())


def _named(capture: Capture, error: InputError) -> InputError:
    return InputError(f"capture {capture.id!r} ({capture.depth_path}): {error}", code=error.code)
