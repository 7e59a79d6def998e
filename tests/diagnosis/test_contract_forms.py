"""Capture sets in every form that the contract allows can be diagnosed, and what is missing is said."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from capture.capture_set import CaptureSet
from capture.picture import read_depth
from capture.prepare import prepare_all
from diagnosis import synthesis
from diagnosis.diagnose import DiagnosisOptions, diagnose
from diagnosis.simulation.drape_cache import DrapeCache
from diagnosis.tasks.fabric_task import FabricTask
from diagnosis.tasks.parameters import (
    FOREIGN_SPREAD,
    LEAST_ESTIMATED_SIGMA,
    TYPICAL_DENSITY_KG_M2,
    UNKNOWN_DENSITY_SIGMA,
    UNKNOWN_SIGMA,
)
from diagnosis.tasks.preparation import not_stated, prepare_tasks
from renderer.camera import CANONICAL_CAMERA
from renderer.depth_png import write_depth_png
from renderer.sensor import SensorModel
from tests.diagnosis.conftest import CANDIDATES, MakeSet

Change = Callable[[dict[str, Any]], None]
MILLIMETRE = 0.001


@pytest.fixture(scope="module")
def plain(make_set: MakeSet) -> CaptureSet:
    """A set without an effect."""
    return make_set()


@pytest.fixture
def altered(plain: CaptureSet, tmp_path: Path) -> Callable[[Change], CaptureSet]:
    """The same, its ``captures.json`` changed by hand."""

    def alter(change: Change) -> CaptureSet:
        folder = tmp_path / "set"
        shutil.copytree(plain.folder, folder)
        path = folder / "captures.json"
        value = json.loads(path.read_text())
        change(value)
        path.write_text(json.dumps(value))
        return CaptureSet.load(folder)

    return alter


def tasks_of(captures: CaptureSet) -> tuple[list[FabricTask], str]:
    tasks, assumed = prepare_tasks(captures, CANDIDATES, 0.02)
    return tasks, "; ".join(assumed)


def in_millimetres(captures: CaptureSet) -> CaptureSet:
    """The same pictures kept in whole millimetres, as many cameras do."""
    for capture in captures.captures:
        write_depth_png(capture.depth_path, read_depth(capture.depth_path, capture.camera), MILLIMETRE)
    path = captures.folder / "captures.json"
    value = json.loads(path.read_text())
    value["camera"]["depth_unit_m"] = MILLIMETRE
    path.write_text(json.dumps(value))
    return CaptureSet.load(captures.folder)


def test_a_set_that_states_everything_assumes_nothing(altered: Callable[[Change], CaptureSet]) -> None:
    tasks, assumed = tasks_of(altered(lambda value: None))
    assert not assumed and len(tasks) == 2
    assert all(c.sensor_known and c.pose_known for task in tasks for c in task.captures)


def test_the_order_of_captures_in_the_file_decides_nothing(altered: Callable[[Change], CaptureSet]) -> None:
    tasks, _ = tasks_of(altered(lambda value: value["captures"].reverse()))
    keys = [[(c.scene.setup.scene.value, c.repeat, c.id) for c in task.captures] for task in tasks]
    assert [task.id for task in tasks] == ["f1", "f2"]
    assert keys == [sorted(own) for own in keys]


def test_a_fabric_without_density_is_taken_wide(altered: Callable[[Change], CaptureSet]) -> None:
    tasks, assumed = tasks_of(altered(lambda value: value["fabrics"][0].update(density=None)))
    assert "fabric f1: no density" in assumed
    assert tasks[0].parameters.density == TYPICAL_DENSITY_KG_M2 and tasks[0].relative_sigma[6] == UNKNOWN_DENSITY_SIGMA
    assert tasks[1].relative_sigma[6] < 0.1


def test_a_fabric_without_parameters_is_estimated_from_its_pictures(altered: Callable[[Change], CaptureSet]) -> None:
    tasks, assumed = tasks_of(altered(lambda value: value["fabrics"][1].update(parameters=None)))
    assert "fabric f2: no parameters; estimated from its captures" in assumed and "fabric f1" not in assumed
    assert min(tasks[1].relative_sigma[:6]) > max(tasks[0].relative_sigma[:6])
    assert min(tasks[1].relative_sigma[:6]) >= FOREIGN_SPREAD * LEAST_ESTIMATED_SIGMA
    assert max(tasks[1].relative_sigma[:6]) <= UNKNOWN_SIGMA
    assert [task.estimated for task in tasks] == [False, True]


def test_a_sensor_that_is_not_stated_judges_no_pixels(altered: Callable[[Change], CaptureSet]) -> None:
    tasks, assumed = tasks_of(altered(lambda value: value.pop("sensor")))
    assert "the sensor's noise is not stated" in assumed
    assert not any(c.sensor_known for task in tasks for c in task.captures)


def test_a_pose_that_is_not_stated_is_found(plain: CaptureSet, altered: Callable[[Change], CaptureSet]) -> None:
    stated, _ = tasks_of(plain)
    tasks, assumed = tasks_of(altered(lambda value: value["setup"].update(camera_from_panel=None)))
    assert "the camera's pose was found in the pictures, to about 10 mm" in assumed  # no hanging pictures
    for task, known in zip(tasks, stated, strict=True):
        assert not any(c.pose_known for c in task.captures)
        for one, other in zip(task.captures, known.captures, strict=True):
            np.testing.assert_allclose(one.scene.pose, other.scene.pose, atol=0.02)


def test_without_a_panel_what_lies_round_the_cloth_does_not_count(
    plain: CaptureSet, altered: Callable[[Change], CaptureSet]
) -> None:
    captures = altered(lambda value: value["setup"].update(panel=False))
    for capture, seen in zip(captures.captures, prepare_all(plain.captures), strict=True):
        wall = np.where(seen.region.mask, seen.depth, np.float32(3.0))
        write_depth_png(capture.depth_path, wall)
    tasks, _ = tasks_of(captures)
    for capture in (c for task in tasks for c in task.captures):
        assert not capture.scene.setup.panel
        assert 0.05 < np.mean(capture.depth > 0.0) < 0.6


def test_one_capture_may_have_a_camera_and_a_set_up_of_its_own(altered: Callable[[Change], CaptureSet]) -> None:
    def change(value: dict[str, Any]) -> None:
        own = value["captures"][1]
        own["camera"] = {**value["camera"], "fx": 1.001 * value["camera"]["fx"]}
        own["setup"] = {"pin_radius_m": 0.005}

    tasks, _ = tasks_of(altered(change))
    first, second = tasks[0].captures[:2]
    assert second.scene.camera.fx == pytest.approx(1.001 * first.scene.camera.fx)
    assert (first.scene.setup.pin_radius_m, second.scene.setup.pin_radius_m) == (0.0, 0.005)


def test_a_sample_that_no_cell_divides_is_simulated_in_whole_cells(altered: Callable[[Change], CaptureSet]) -> None:
    tasks, assumed = tasks_of(altered(lambda value: value["setup"].update(sample_size_m=[0.503, 0.498])))
    assert "the sample of 503 x 498 mm is simulated as 500.5 x 500.5 mm, in whole cells" in assumed
    assert tasks[0].captures[0].scene.setup.sample_size_m == pytest.approx((0.5005, 0.5005))


def test_what_is_simulated_otherwise_than_stated_is_told(altered: Callable[[Change], CaptureSet]) -> None:
    def change(value: dict[str, Any]) -> None:
        value["setup"]["pin_radius_m"] = 0.016
        value["fabrics"][0]["parameters"].update(bending_warp=1e-4, bending_weft=1e-6, bending_bias=1e-5)

    tasks, assumed = tasks_of(altered(change))
    assert tasks[0].captures[0].scene.setup.pin_radius_m == pytest.approx(0.02, rel=1e-5)
    assert "hold 16 mm round a corner are simulated as holding 20 mm, a whole cell" in assumed
    assert "has a bending_bias of 1e-05 N·m; simulated with 2.04e-05 N·m, the least there is" in assumed


def test_pictures_in_whole_millimetres_are_not_called_quantised(
    altered: Callable[[Change], CaptureSet], shelf: DrapeCache
) -> None:
    """The sensor states steps of 0.2 mm; the file's own are coarser, and the simulation is rounded alike."""
    captures = in_millimetres(altered(lambda value: None))
    (task, *_), _ = tasks_of(captures)
    assert task.captures[0].scene.sensor.quantisation_m == MILLIMETRE
    options = DiagnosisOptions(effects=(*CANDIDATES, "quantisation"), resolution_m=0.02, afresh=False)
    report = diagnose(captures, options, cache=shelf).report
    assert report.cause.top == "none"
    assert report.cause.probabilities["quantisation"] < 0.05


def test_usual_values_that_are_taken_are_said(altered: Callable[[Change], CaptureSet]) -> None:
    def silent(value: dict[str, Any]) -> None:
        value["setup"] = {"camera_from_panel": value["setup"]["camera_from_panel"]}
        value["fabrics"][0].pop("parameters_cv", None)
        value["fabrics"][1].pop("density_cv", None)

    _, assumed = tasks_of(altered(silent))
    assert "parameters_cv is not stated (f1): parameters are taken as known to 7%" in assumed
    assert "density_cv is not stated (f2): densities are taken as known to 2%" in assumed
    assert "pins_m is not stated (stretch)" in assumed
    assert "pin_radius_m is not stated: magnets are taken to hold 10 mm" in assumed
    assert "sample_size_m is not stated: samples are taken as 500 x 500 mm" in assumed


def test_noise_without_a_distance_is_that_at_the_panel(altered: Callable[[Change], CaptureSet]) -> None:
    def vague(value: dict[str, Any]) -> None:
        value["sensor"] = {"range_noise_m": 0.001}
        del value["setup"]["panel"]

    tasks, assumed = tasks_of(altered(vague))
    scene = tasks[0].captures[0].scene
    assert scene.sensor.at_m == pytest.approx(float(scene.camera_from_panel[2, 3]))
    assert "at_m of the sensor is not stated: its noise is taken as that at the panel's distance" in assumed
    assert "quantisation_m of the sensor is not stated" in assumed
    assert "panel is not stated: a panel is taken to stand behind the cloth" in assumed


def test_one_fabric_alone_in_stretch_is_said(altered: Callable[[Change], CaptureSet]) -> None:
    def hang(value: dict[str, Any]) -> None:
        for capture in value["captures"]:
            capture["scene"] = "stretch" if capture["fabric"] == "f1" else "hanging"

    captures = altered(hang)
    assert any("only f1 of 2 fabrics are captured in stretch" in line for line in not_stated(captures))


def test_an_uncertainty_in_percent_is_cut_and_said(altered: Callable[[Change], CaptureSet]) -> None:
    tasks, assumed = tasks_of(altered(lambda value: value["fabrics"][0].update(parameters_cv=7, density_cv=2)))
    assert tasks[0].relative_sigma == (0.8,) * 7
    assert "fabric f1: parameters_cv 7 is taken as 0.8" in assumed and "density_cv 2 is taken as 0.8" in assumed


@pytest.mark.parametrize("behind_m", [0.0, 1.6])
def test_a_panel_that_does_not_fill_the_picture_is_no_effect(
    behind_m: float, altered: Callable[[Change], CaptureSet], shelf: DrapeCache
) -> None:
    captures = altered(lambda value: None)
    for capture in captures.captures:
        depth = read_depth(capture.depth_path, capture.camera).copy()
        depth[:, :60] = depth[:, -70:] = np.float32(behind_m)
        depth[-30:] = np.float32(behind_m)
        write_depth_png(capture.depth_path, depth)
    options = DiagnosisOptions(effects=(*CANDIDATES, "dropout"), resolution_m=0.02)
    report = diagnose(CaptureSet.load(captures.folder), options, cache=shelf).report
    assert report.cause.top == "none" and not report.gap.detected
    assert report.gap.value < 5.0


def test_repeats_may_be_seen_by_two_cameras(make_set: MakeSet, shelf: DrapeCache, tmp_path: Path) -> None:
    """Pixels of pictures of other sizes are not compared; what there is to find is found."""
    folder, made = tmp_path / "set", make_set("depth_scale=0.02")
    shutil.copytree(made.folder, folder)
    value = json.loads((folder / "captures.json").read_text())
    camera = value["camera"]
    half = {key: camera[key] / 2 for key in ("fx", "fy", "cx", "cy")}
    for capture in (c for c in value["captures"] if c["repeat"] == 1):
        depth = read_depth(folder / capture["depth"], made.captures[0].camera)
        write_depth_png(folder / capture["depth"], depth[::2, ::2])
        capture["camera"] = {**camera, **half, "width": camera["width"] // 2, "height": camera["height"] // 2}
    (folder / "captures.json").write_text(json.dumps(value))
    report = diagnose(CaptureSet.load(folder), DiagnosisOptions(CANDIDATES, resolution_m=0.02), cache=shelf).report
    assert report.cause.top == "depth_scale"
    assert report.shrinkage is not None


def test_an_effect_that_only_scatters_repeats_may_be_tried_alone(plain: CaptureSet, shelf: DrapeCache) -> None:
    options = DiagnosisOptions(effects=("bending_hysteresis",), resolution_m=0.02)
    report = diagnose(plain, options, cache=shelf).report
    assert set(report.cause.probabilities) == {"none", "unknown", "bending_hysteresis"}


@pytest.mark.parametrize("effect", [None, "air_draft=0.2"])
def test_a_quiet_sensor_does_not_take_folds_for_noise(
    effect: str | None, monkeypatch: pytest.MonkeyPatch, make_set: MakeSet, shelf: DrapeCache
) -> None:
    """Rendered sets state no noise; what two drapes differ by is far more than that, on cloth."""
    monkeypatch.setattr(synthesis, "SET_SENSOR", SensorModel(quantisation_m=0.0001))
    monkeypatch.setattr(synthesis, "SET_CAMERA", CANONICAL_CAMERA)
    captures = make_set(*([effect] if effect else []))
    assert captures.captures[0].camera == CANONICAL_CAMERA
    report = diagnose(captures, DiagnosisOptions(CANDIDATES, resolution_m=0.02), cache=shelf).report
    assert report.cause.top == ("air_draft" if effect else "none")
    assert report.gap.detected is (effect is not None)
