"""What a set states is enough to refuse what no simulation can put up, and to plan without a picture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from capture.capture_set import CaptureSet, new_document
from diagnosis.isolability import in_scene
from diagnosis.tasks.planned import planned_tasks
from diagnosis.tasks.preparation import prepare_tasks
from renderer.camera import CANONICAL_CAMERA, frontal_pose
from simcore.errors import InputError
from simcore.parameters import FabricParameters
from simcore.scenes import Scene

FABRIC = FabricParameters(800.0, 600.0, 150.0, 4e-5, 3e-5, 5e-5, 0.2).as_dict()
HANGING = {"top_left": [-0.19, 0.0, 0.0], "top_right": [0.21, 0.0, 0.004]}
STRETCH = {"top_left": [-0.24, 0.0, 0.0], "top_right": [0.24, 0.0, 0.0], "bottom_right": [0.26, -0.51, 0.0]}
SENSOR = {"range_noise_m": 0.001, "at_m": 0.9, "quantisation_m": 0.0002}


def stated(sensor: dict[str, Any] | None = None, own: dict[str, Any] | None = None, **setup: Any) -> CaptureSet:
    """One fabric twice in ``stretch``, everything stated and no picture taken; ``own`` is said of the second."""
    usual = {
        "sample_size_m": [0.503, 0.5],
        "panel": True,
        "pin_radius_m": 0.01,
        "camera_from_panel": frontal_pose().tolist(),
        "pins_m": {"stretch": STRETCH, "hanging": HANGING},
    }
    captures = [
        {
            "id": f"f-{n}",
            "fabric": "f",
            "scene": "stretch",
            "repeat": n,
            "depth": f"{n}.png",
            **(own or {} if n else {}),
        }
        for n in range(2)
    ]
    density, parameters = FABRIC["density"], {name: FABRIC[name] for name in FABRIC if name != "density"}
    fabric = {"id": "f", "density": density, "parameters": parameters, "parameters_cv": 0.07, "density_cv": 0.02}
    document = new_document(
        name="planned",
        camera=CANONICAL_CAMERA,
        fabrics=[fabric],
        captures=captures,
        setup=usual | setup,
        sensor=SENSOR if sensor is None else sensor,
    )
    return CaptureSet(Path("nowhere"), document)


@pytest.mark.parametrize(
    ("pins", "code"),
    [
        ({"bottom_right": [0.26, 0.1, 0]}, "pins_crossed"),
        ({"bottom_right": [0.26, -0.51, -0.02]}, "pin_behind_panel"),
    ],
)
def test_pins_that_cannot_be_are_refused_before_any_picture_is_read(pins: dict[str, Any], code: str) -> None:
    captures = stated(own={"setup": {"pins_m": {"stretch": pins}}})
    for tasks in (prepare_tasks, planned_tasks):
        with pytest.raises(InputError, match=r"^capture f-1: pin ") as caught:
            tasks(captures, (), 0.01)
        assert caught.value.code == code


def test_a_scene_that_a_set_lacks_has_the_pins_that_it_states_for_it() -> None:
    captures = stated()
    ((task,), _) = planned_tasks(captures, (), 0.01)
    there = in_scene(captures, task, Scene.HANGING)
    assert [c.id for c in there.captures] == ["f-0", "f-1"]
    setup, own = there.captures[0].scene.setup, task.captures[0].scene.setup
    across = own.sample_size_m[0] / 0.503
    assert across != 1.0 and setup.sample_size_m == own.sample_size_m
    assert setup.pins_m["top_left"] == pytest.approx((-0.19 * across, 0.0, 0.0))
    assert setup.pins_m["top_right"] == pytest.approx((0.21 * across, 0.0, 0.004))


@pytest.mark.parametrize(
    ("pins", "code"),
    [({"top_left": [0.2, 0, 0], "top_right": [-0.2, 0, 0]}, "pins_crossed"), ({"top_left": [0, 0, 0]}, "pins_missing")],
)
def test_pins_that_cannot_be_in_the_lacking_scene_name_it(pins: dict[str, Any], code: str) -> None:
    captures = stated(pins_m={"stretch": STRETCH, "hanging": pins})
    ((task,), _) = planned_tasks(captures, (), 0.01)
    with pytest.raises(InputError, match=r"^capture f-0 in hanging: ") as caught:
        in_scene(captures, task, Scene.HANGING)
    assert caught.value.code == code


def test_a_plan_says_what_it_assumes() -> None:
    assumed = planned_tasks(stated(), (), 0.01)[1]
    assert len(assumed) == 1 and "the sample of 503 x 500 mm is simulated as" in assumed[0]
    assumed = planned_tasks(stated(sensor={}, pins_m=None), (), 0.01)[1]
    assert "the sensor's noise is not stated: sensor effects on pixels cannot be judged" in assumed
    assert any("pins_m is not stated (stretch)" in line for line in assumed)


def test_what_is_said_of_sensors_in_vain_is_told() -> None:
    further = {"smoothing_px": 1.0, "dropout": 0.1, "model": None}
    (line,) = planned_tasks(stated(SENSOR | further, sample_size_m=[0.5, 0.5]), (), 0.01)[1]
    assert line.startswith("stated, but not used: sensor.smoothing_px, sensor.dropout; of sensors the set's")
    camera = stated().document.camera.model_dump() | {"fx": 321.0, "sensor": SENSOR}
    captures = stated(own={"sensor": SENSOR, "camera": camera}, sample_size_m=[0.5, 0.5])
    unused, other = planned_tasks(captures, (), 0.01)[1]
    assert unused.startswith("stated, but not used: sensor of capture f-1, camera.sensor of capture f-1;")
    assert other == "capture f-1: the camera is another one than the set's: the set's sensor counts for it, too"
