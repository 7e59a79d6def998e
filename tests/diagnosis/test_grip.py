"""Magnets that hold the cloth otherwise than stated."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from capture.capture_set import CaptureSet
from diagnosis.diagnose import DiagnosisOptions, diagnose
from diagnosis.drape_cache import DrapeCache
from diagnosis.grip import Grip, with_other_grip
from diagnosis.preparation import prepare_tasks
from diagnosis.synthesis import SynthesisPlan, make_capture_set

PLAN = SynthesisPlan(fabrics=2, scenes=("stretch",), resolution_m=0.5 / 60, repeats=1, pin_radius_m=0.0, seed=77)


@pytest.fixture(scope="module")
def points(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A set whose magnets held a point, as its document says."""
    return make_capture_set(tmp_path_factory.mktemp("points"), PLAN).folder


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> DrapeCache:
    """Simulations of both statements."""
    return DrapeCache(tmp_path_factory.mktemp("drapes"))


def stated(folder: Path, radius_m: float) -> CaptureSet:
    """The set with another statement."""
    path = folder / "captures.json"
    document = json.loads(path.read_text())
    document["setup"]["pin_radius_m"] = radius_m
    path.write_text(json.dumps(document))
    return CaptureSet.load(folder)


def test_the_other_way_is_believed_only_when_it_is_nearer_by_far_in_every_fabric() -> None:
    near, far = np.array([1e-3, 1e-3, 1e-3]), np.array([2e-3, 2e-3, 2e-3])
    assert Grip(far, near).otherwise
    assert not Grip(near, far).otherwise
    assert not Grip(far, 0.8 * far).otherwise
    assert not Grip(far, np.array([5e-4, 5e-4, 2.1e-3])).otherwise


def test_it_says_which_way_the_magnets_hold() -> None:
    grip = Grip(np.array([2e-3, 2e-3]), np.array([1e-3, 1e-3]))
    assert "a point of the cloth, not the stated 10 mm" in grip.sentence(0.01)
    assert "a patch of the cloth, not the stated point" in grip.sentence(0.0)
    assert "2.00 to 1.00 mm" in grip.sentence(0.0)


def test_all_captures_of_a_fabric_are_held_the_other_way(points: Path) -> None:
    task = prepare_tasks(stated(points, 0.01), ["panel_tilt"], 0.01)[0][0]
    other = with_other_grip(task)
    assert [c.scene.setup.pin_radius_m for c in other.captures] == [0.0] * len(task.captures)
    back = with_other_grip(other)
    assert all(c.scene.setup.pin_radius_m >= 0.01 for c in back.captures)
    assert replace(other, captures=task.captures) == task


OPTIONS = DiagnosisOptions(effects=("panel_tilt",))


def test_points_stated_as_patches_are_found_out(points: Path, kept: DrapeCache) -> None:
    found = diagnose(stated(points, 0.01), OPTIONS, cache=kept)
    assert any("hold a point" in text for text in found.assumed)
    assert found.report.cause.top == "none"
    assert all(c.scene.setup.pin_radius_m == 0.0 for r in found.results for c in r.task.captures)
    assert found.report.gap.value < 1.0


def test_points_stated_as_points_are_left_as_they_are(points: Path, kept: DrapeCache) -> None:
    right = diagnose(stated(points, 0.0), OPTIONS, cache=kept)
    assert not any("magnets" in text for text in right.assumed)
    assert right.report.cause.top == "none"
