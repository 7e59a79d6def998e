"""From a capture set to the tasks of its diagnosis; what is missing is estimated or taken wide."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from capture.capture_set import Capture, CaptureSet
from capture.prepare import PreparedCapture, prepare_all
from capture.report import MAX_PIN_ERROR_M, at_border, pins_far
from capture.setup import passed_over
from diagnosis.scene import SimulationScene
from diagnosis.simulation.pose_error import BY_CORNERS_M, BY_OUTLINE_M
from diagnosis.tasks.capture_scene import capture_scene
from diagnosis.tasks.enough import check_kept
from diagnosis.tasks.fabric_task import STATED_DENSITY_SIGMA, CaptureTask, FabricTask
from diagnosis.tasks.meshing import MOST_CHANGED, cell_size
from diagnosis.tasks.parameters import STATED_SIGMA, stated_parameters
from diagnosis.tasks.put_up import check_set_ups, in_order
from diagnosis.tasks.sensors import sensors_passed_over, usual_distance
from renderer.depth import panel_depth
from simcore.errors import InputError
from simcore.scenes import Scene

AWAY_M, AWAY_SHARE = 0.1, 0.05
"""What lies further behind or before the panel, in metres and as a share of its depth, is no panel, whatever the
camera does."""
CLOTH_RIM_PX = 3


def prepare_tasks(
    captures: CaptureSet, effects: Sequence[str], resolution_m: float
) -> tuple[list[FabricTask], list[str]]:
    """Tasks fabric by fabric, and what had to be assumed, in words.

    Raises:
        InputError: captures that cannot be used, or a mesh that does not fit the sample.
    """
    if not captures.captures:
        raise InputError(f"{captures.folder}: the set lists no captures", code="no_captures")
    check_set_ups(captures, resolution_m)
    assumed = list(not_stated(captures))
    prepared = _prepared(captures, assumed)
    usual_m = usual_distance(ready.registration.camera_from_panel for ready in prepared.values())
    tasks = []
    for fabric_id, fabric in captures.fabrics.items():
        own = [capture for capture in in_order(captures.of_fabric(fabric_id)) if capture.id in prepared]
        if not own:
            continue
        own = once_each(own, prepared, assumed)
        parameters, sigma = stated_parameters(fabric, [prepared[c.id] for c in own], assumed)
        cell = cell_size(own[0].setup.sample_size_m, resolution_m)
        items = []
        for capture in own:
            ready = prepared[capture.id]
            pose = ready.registration.camera_from_panel
            scene = capture_scene(capture, pose, cell, usual_m)
            depth = _compared(ready, scene)
            off = pose_error(ready, prepared.values())
            items.append(CaptureTask(capture.id, capture.repeat, depth, scene, sensor_known(capture), off))
        assumed += recut(fabric_id, own, items)
        estimated = fabric.parameters is None
        tasks.append(FabricTask(fabric_id, parameters, sigma, tuple(items), tuple(effects), cell, estimated))
    found = max(c.pose_error_m for task in tasks for c in task.captures)
    assumed += doubts(prepared.values())
    if found > 0.0:
        assumed.append(
            f"the camera's pose was found in the pictures, to about {1e3 * found:.0f} mm along the panel: state "
            "camera_from_panel to have errors of the pose and axial sensor errors told, and small gaps seen"
        )
    return tasks, assumed


def _prepared(captures: CaptureSet, assumed: list[str]) -> dict[str, PreparedCapture]:
    """Captures that show cloth, by id: one in which it lies too flat on the panel to be seen does not stop the others.

    What is left out is appended to ``assumed``.

    Raises:
        InputError: captures that cannot be used, or half of them or more show no cloth.
    """
    without: dict[str, InputError] = {}
    prepared = {
        ready.capture.id: ready
        for ready in prepare_all(captures.captures, lambda capture, error: without.update({capture.id: error}))
    }
    if len(without) >= len(prepared):
        raise next(iter(without.values()))
    assumed += [
        f"capture {name} is left out: no cloth is seen in it; look whether the sample is in the picture, or lies flat "
        "on the panel"
        for name in without
    ]
    return prepared


def once_each(
    captures: Sequence[Capture], prepared: Mapping[str, PreparedCapture], assumed: list[str]
) -> list[Capture]:
    """A fabric's captures without those that show again what an earlier one of the same scene shows, to the last
    pixel: no second look at a sample is that, and as repeats they would say that nothing scatters.

    What is left out is appended to ``assumed``.
    """
    kept: list[Capture] = []
    for capture in captures:
        depth = prepared[capture.id].depth
        alike = (c for c in kept if c.scene == capture.scene and np.array_equal(prepared[c.id].depth, depth))
        first = next(alike, None)
        if first is None:
            kept.append(capture)
        else:
            assumed.append(f"captures {first.id} and {capture.id} are the same picture, no repeats: it counts once")
    return kept


def pose_error(ready: PreparedCapture, prepared: Iterable[PreparedCapture]) -> float:
    """What a capture's pose may be off by along the panel [m], see :mod:`diagnosis.simulation.pose_error`.

    It is as good as corners show it where a hanging picture gave the same pose, and no better than the pins were found
    where most of the pictures that gave it show them elsewhere than the set-up has them.
    """
    if ready.capture.camera_from_panel is not None:
        return 0.0
    pose = ready.registration.camera_from_panel
    shared = [p for p in prepared if np.array_equal(p.registration.camera_from_panel, pose)]
    usual = BY_CORNERS_M if any(p.capture.scene is Scene.HANGING for p in shared) else BY_OUTLINE_M
    pins = [p.registration.pin_error_m for p in shared if p.registration.pin_error_m is not None]
    off = float(np.median(pins)) if pins else 0.0
    return max(usual, off) if off > MAX_PIN_ERROR_M else usual


def doubts(prepared: Iterable[PreparedCapture]) -> list[str]:
    """In words, what speaks against pictures and the poses found in them, each with the captures that it holds of."""
    found: dict[str, list[str]] = {}
    for ready in prepared:
        for doubt in (*at_border(ready.region), *pins_far(ready.registration), *ready.registration.unusual):
            found.setdefault(doubt, []).append(ready.capture.id)
    return [f"capture {', '.join(names)}: {doubt}" for doubt, names in found.items()]


def _compared(ready: PreparedCapture, scene: SimulationScene) -> NDArray[np.float32]:
    """What of a picture is compared [m], 0 elsewhere, [H, W]."""
    if not scene.setup.panel:
        depth = np.where(ready.region.mask, ready.depth, np.float32(0.0))
    else:
        try:
            depth = without_surroundings(ready.depth, ready.region.mask, scene)
        except InputError as error:
            raise InputError(f"capture {ready.capture.id}: {error}", code=error.code) from None
    stated = ready.capture.camera_from_panel is not None
    check_kept(ready.capture.id, ready.depth, depth, scene, pose_stated=stated)
    return depth


def without_surroundings(
    depth: NDArray[np.float32], cloth: NDArray[np.bool_], scene: SimulationScene
) -> NDArray[np.float32]:
    """A picture [m] without what is neither cloth nor panel: the simulated panel has no end, and nothing before it.

    Args:
        depth: of the capture [m], [H, W].
        cloth: where it shows the cloth, bool [H, W].
        scene: how the camera sees the panel.
    """
    panel = panel_depth(scene.camera, scene.camera_from_panel)
    away = np.maximum(AWAY_M, AWAY_SHARE * panel)
    near_cloth = ndimage.binary_dilation(cloth, iterations=CLOTH_RIM_PX)
    other = (depth > panel + away) | ((depth < panel - away) & ~near_cloth)
    return np.where(other, np.float32(0.0), depth)


def not_stated(captures: CaptureSet) -> Iterator[str]:
    """In words, what a set leaves open, so that usual values are taken: uncertainties, parts of the set-up, sensors."""
    fabrics = [captures.fabrics[name] for name in dict.fromkeys(c.fabric.id for c in captures.captures)]
    vague = [f.id for f in fabrics if f.parameters is not None and f.parameters_cv is None]
    if vague:
        yield f"parameters_cv is not stated ({', '.join(vague)}): parameters are taken as known to {STATED_SIGMA:.0%}"
    vague = [f.id for f in fabrics if f.density is not None and f.density_cv is None]
    if vague:
        known = f"{STATED_DENSITY_SIGMA:.0%}"
        yield f"density_cv is not stated ({', '.join(vague)}): densities are taken as known to {known}"
    pins = sorted({c.scene.value for c in captures.captures if c.pins_from == "nominal"})
    if pins:
        yield f"pins_m is not stated ({', '.join(pins)}): pins are taken where they are nominally"
    setups = [captures.stated_setup(capture.document) for capture in captures.captures]
    over = {(c.scene.value, n) for c, s in zip(captures.captures, setups, strict=True) for n in passed_over(c.scene, s)}
    for scene, name in sorted(over):
        yield f"pin {name} is stated for {scene}, which has none of that name: the sample is taken as not held there"
    stretched = {c.fabric.id for c in captures.captures if c.scene is Scene.STRETCH}
    if 0 < len(stretched) < len(fabrics):
        yield (
            f"only {', '.join(f.id for f in fabrics if f.id in stretched)} of {len(fabrics)} fabrics are captured in "
            "stretch: the gap, and how far it shrinks, are theirs alone"
        )
    if any(setup.pin_radius_m is None for setup in setups):
        yield "pin_radius_m is not stated: magnets are taken to hold 10 mm round a corner"
    if any(setup.panel is None for setup in setups):
        yield "panel is not stated: a panel is taken to stand behind the cloth"
    if any(setup.sample_size_m is None for setup in setups):
        yield "sample_size_m is not stated: samples are taken as 500 x 500 mm"
    sensors = [c.sensor for c in captures.captures if c.sensor is not None and c.sensor.range_noise_m is not None]
    if any(sensor.at_m is None for sensor in sensors):
        yield "at_m of the sensor is not stated: its noise is taken as that at the panel's distance"
    if any(sensor.quantisation_m is None for sensor in sensors):
        yield "quantisation_m of the sensor is not stated: depths are taken as rounded to depth_unit_m alone"
    if not all(sensor_known(c) for c in captures.captures):
        yield "the sensor's noise is not stated: sensor effects on pixels cannot be judged"
    yield from sensors_passed_over(captures)


def recut(fabric_id: str, captures: Sequence[Capture], tasks: Sequence[CaptureTask]) -> list[str]:
    """In words, samples that are simulated in another size and magnets that hold more, as whole cells want it."""
    pairs = [(capture.setup, task.scene.setup) for capture, task in zip(captures, tasks, strict=True)]
    sizes = {(*a.sample_size_m, *b.sample_size_m): None for a, b in pairs if a.sample_size_m != b.sample_size_m}
    radii = {
        (a.pin_radius_m, b.pin_radius_m): None
        for a, b in pairs
        if b.pin_radius_m > (1.0 + MOST_CHANGED) * a.pin_radius_m
    }
    return [
        *(
            f"fabric {fabric_id}: the sample of {1e3 * a:.4g} x {1e3 * b:.4g} mm is simulated as "
            f"{1e3 * c:.4g} x {1e3 * d:.4g} mm, in whole cells"
            for a, b, c, d in sizes
        ),
        *(
            f"fabric {fabric_id}: magnets that hold {1e3 * a:.4g} mm round a corner are simulated as holding "
            f"{1e3 * b:.4g} mm, a whole cell"
            for a, b in radii
        ),
    ]


def sensor_known(capture: Capture) -> bool:
    """The set states the sensor's noise."""
    return capture.sensor is not None and capture.sensor.range_noise_m is not None
