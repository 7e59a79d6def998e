"""Tasks of captures that need not have been taken yet: what the set states about them is enough to simulate."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from capture.capture_set import Capture, CaptureSet
from diagnosis.tasks.capture_scene import capture_scene
from diagnosis.tasks.fabric_task import CaptureTask, FabricTask
from diagnosis.tasks.meshing import cell_size
from diagnosis.tasks.parameters import stated_parameters
from diagnosis.tasks.preparation import not_stated, prepare_tasks, recut, sensor_known
from diagnosis.tasks.put_up import in_order
from diagnosis.tasks.sensors import usual_distance
from simcore.errors import InputError

NAMED = 3
"""So many absent pictures are named in a message."""


def planned_tasks(
    captures: CaptureSet, effects: Sequence[str], resolution_m: float
) -> tuple[list[FabricTask], list[str]]:
    """What :func:`diagnosis.tasks.preparation.prepare_tasks` gives, for work that looks at no picture.

    Where the set states all fabrics' parameters and density and the camera's pose, no picture is opened and none need
    be there; the tasks' pictures hold no data. Otherwise what is missing is found in the pictures, as for a diagnosis.

    Args:
        captures: read with ``read_pictures=False`` where pictures may be absent.
        effects: names of the effects to try.
        resolution_m: wanted edge of a mesh cell.

    Raises:
        InputError: ``plan_incomplete``: pictures are absent and the set does not state what they would have to tell;
            captures that cannot be used; a mesh that does not fit the sample.
    """
    wanting = _wanting(captures)
    if not wanting:
        assumed = list(not_stated(captures))
        taken = [in_order(captures.of_fabric(name)) for name in captures.fabrics]
        usual_m = usual_distance(c.camera_from_panel for c in captures.captures if c.camera_from_panel is not None)
        return [_task(own, effects, resolution_m, usual_m, assumed) for own in taken if own], assumed
    absent = [capture for capture in captures.captures if not capture.depth_path.exists()]
    if absent:
        names = ", ".join(capture.depth_path.name for capture in absent[:NAMED])
        raise InputError(
            f"{captures.folder}: {len(absent)} of {len(captures.captures)} pictures are not there "
            f"({names}{', ...' if len(absent) > NAMED else ''}): before they are taken, captures.json must state "
            f"{'; '.join(wanting)}",
            code="plan_incomplete",
        )
    return prepare_tasks(captures, effects, resolution_m)


def _wanting(captures: CaptureSet) -> list[str]:
    """What pictures would have to tell, in words."""
    wanting = []
    for name, fabric in captures.fabrics.items():
        missing = [key for key in ("parameters", "density") if getattr(fabric, key) is None]
        if missing and captures.of_fabric(name):
            wanting.append(f"{' and '.join(missing)} of fabric {name}")
    unposed = [capture.id for capture in captures.captures if capture.camera_from_panel is None]
    if unposed:
        where = "setup" if len(unposed) == len(captures.captures) else f"the setup of {', '.join(unposed)}"
        wanting.append(f"camera_from_panel in {where}")
    return wanting


def _task(
    own: Sequence[Capture], effects: Sequence[str], resolution_m: float, usual_m: float, assumed: list[str]
) -> FabricTask:
    """One fabric with everything stated; what had to be assumed is appended to ``assumed``."""
    fabric = own[0].fabric
    parameters, sigma = stated_parameters(fabric, (), assumed)
    cell = cell_size(own[0].setup.sample_size_m, resolution_m)
    items = tuple(_capture_task(capture, cell, usual_m) for capture in own)
    assumed += recut(fabric.id, own, items)
    return FabricTask(fabric.id, parameters, sigma, items, tuple(effects), cell)


def _capture_task(capture: Capture, cell_m: float, usual_m: float) -> CaptureTask:
    assert capture.camera_from_panel is not None
    camera = capture.camera
    scene = capture_scene(capture, capture.camera_from_panel, cell_m, usual_m)
    nothing = np.zeros((camera.height, camera.width), dtype=np.float32)
    return CaptureTask(capture.id, capture.repeat, nothing, scene, sensor_known(capture))
