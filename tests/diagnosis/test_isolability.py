"""What captures can tell apart is known from responses alone, before there are captures."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from capture.capture_set import CAPTURES_FILE, CaptureSet
from diagnosis.atlas_part import atlas_parts
from diagnosis.isolability import Isolability, analyse
from diagnosis.remedies import remedy
from diagnosis.separation import Separation
from diagnosis.simulation.drape_cache import DrapeCache
from diagnosis.tasks.parameters import TYPICAL_DENSITY_KG_M2
from diagnosis.tasks.planned import planned_tasks
from diagnosis.tasks.preparation import prepare_tasks
from simcore.errors import InputError
from tests.diagnosis.conftest import MakeSet

EFFECTS = ("air_draft", "depth_bias", "depth_scale", "pin_spacing", "range_noise")
Change = Callable[[dict[str, Any]], None]


@pytest.fixture(scope="module")
def taken(make_set: MakeSet) -> CaptureSet:
    """A set with its pictures."""
    return make_set()


def plan(taken: CaptureSet, folder: Path, change: Change | None = None) -> CaptureSet:
    """What the set says, without a single picture."""
    document = json.loads((taken.folder / CAPTURES_FILE).read_text(encoding="utf-8"))
    if change is not None:
        change(document)
    (folder / CAPTURES_FILE).write_text(json.dumps(document), encoding="utf-8")
    return CaptureSet.load(folder, read_pictures=False)


def test_axial_errors_look_alike_and_others_do_not(taken: CaptureSet, shelf: DrapeCache) -> None:
    found = analyse(taken, EFFECTS, 0.02, shelf)
    confused = {(p.effect, p.other) for p in found.confused()}
    assert ("depth_bias", "depth_scale") in confused and ("depth_scale", "depth_bias") in confused
    assert ("air_draft", "pin_spacing") not in confused and ("range_noise", "depth_bias") not in confused
    assert found.invisible() == ()
    assert found.scenes == ("stretch",)
    pair = next(p for p in found.pairs if (p.effect, p.other) == ("depth_bias", "depth_scale"))
    assert pair.share < 0.1
    assert pair.own_nats == found.own_nats["depth_bias"]
    assert "distance" in remedy(pair.effect, pair.other, found)
    # what such captures cannot tell apart was looked for in the scene that they lack, too
    assert set(found.by_scene) == {"stretch", "hanging"}
    assert found.by_scene["stretch"] == {(p.effect, p.other): p.nats for p in found.pairs}
    assert found.by_scene["hanging"].keys() == found.by_scene["stretch"].keys()


def test_what_would_separate_two_effects_is_computed_where_it_can_be() -> None:
    def found(nats: float, hanging: float) -> Isolability:
        pair = Separation("pin_spacing", "off_grain", 0.1, nats, 20.0)
        key = {("pin_spacing", "off_grain"): hanging}
        return Isolability((pair,), ("stretch",), {}, by_scene={"stretch": {}, "hanging": key})

    pair = ("pin_spacing", "off_grain")
    assert remedy(*pair, found(2.0, 5.0)) == "capture in hanging, too"
    assert remedy(*pair, found(1.1, 2.0)) == "about 3 times as many fabrics"
    assert "pin distance" in remedy(*pair, found(0.1, 2.0)) == remedy(*pair)
    assert "bare panel" in remedy("range_noise", "quantisation")
    assert "angle" in remedy("camera_rotation", "focal_scale")
    assert "quarter" in remedy("rest_curvature", "edge_curl")
    assert "antistatic" in remedy("panel_adhesion", "air_draft")


def test_it_is_known_before_anything_is_captured(taken: CaptureSet, shelf: DrapeCache, tmp_path: Path) -> None:
    planned = plan(taken, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [CAPTURES_FILE]
    analyse(planned, EFFECTS, 0.02, shelf)  # what is kept is rounded: from here on both are read from the cache
    assert analyse(planned, EFFECTS, 0.02, shelf) == analyse(taken, EFFECTS, 0.02, shelf)


def test_what_cannot_be_judged_is_said(taken: CaptureSet, shelf: DrapeCache, tmp_path: Path) -> None:
    blind = plan(taken, tmp_path, lambda document: document.pop("sensor"))
    found = analyse(blind, ("depth_bias", "range_noise", "bending_hysteresis"), 0.02, shelf)
    assert found.invisible() == ("range_noise",)  # its share of the pixels is not among the numbers at all
    assert found.left_out == ("bending_hysteresis",)
    assert found.assumed == ("the sensor's noise is not stated: sensor effects on pixels cannot be judged",)
    assert set(found.own_nats) == {"depth_bias", "range_noise"}
    alone = analyse(blind, ("range_noise",), 0.02, shelf)
    assert alone.pairs == () and alone.invisible() == ("range_noise",)


def odd_in_many_ways(document: dict[str, Any]) -> None:
    """A sample that is not made of whole cells, other pins, other poses and cameras, one fabric less sure."""
    document["setup"] |= {"sample_size_m": [0.503, 0.5], "pin_radius_m": 0.008}
    document["setup"]["pins_m"]["stretch"]["top_left"] = [-0.24, 0.001, 0.0]
    del document["fabrics"][0]["parameters_cv"]
    document["setup"]["camera_from_panel"][0][3] += 0.004
    document["captures"][0]["camera"] = {**document["camera"], "fx": 480.0}


@pytest.mark.parametrize("change", [None, odd_in_many_ways, lambda document: document.pop("sensor")])
def test_a_plan_is_simulated_as_the_captures_would_be(taken: CaptureSet, tmp_path: Path, change: Change | None) -> None:
    planned = plan(taken, tmp_path, change)
    there = CaptureSet(taken.folder, planned.document)
    tasks, assumed = planned_tasks(planned, EFFECTS, 0.02)
    assert assumed == prepare_tasks(there, EFFECTS, 0.02)[1]
    for task, taken_task in zip(tasks, prepare_tasks(there, EFFECTS, 0.02)[0], strict=True):
        for one, other in zip(task.captures, taken_task.captures, strict=True):
            assert one.depth.shape == other.depth.shape and not one.depth.any()
            assert vars(one) | {"depth": None} == vars(other) | {"depth": None}
        assert replace(task, captures=()) == replace(taken_task, captures=())
    assert atlas_parts(planned, EFFECTS, 0.02) == atlas_parts(there, EFFECTS, 0.02) != []


def remove(*keys: str) -> Change:
    def change(document: dict[str, Any]) -> None:
        for key in keys:
            document["fabrics"][1].pop(key)

    return change


@pytest.mark.parametrize(
    ("change", "wanted"),
    [
        (remove("parameters"), "captures.json must state parameters of fabric f2$"),
        (remove("density"), "captures.json must state density of fabric f2$"),
        (remove("parameters", "density"), "must state parameters and density of fabric f2$"),
        (lambda d: d["setup"].pop("camera_from_panel"), "captures.json must state camera_from_panel in setup$"),
        (
            lambda d: d["captures"][1].update(setup={"camera_from_panel": None}),
            "must state camera_from_panel in the setup of f1-stretch-1$",
        ),
    ],
)
def test_a_plan_that_leaves_something_to_pictures_is_refused(
    taken: CaptureSet, tmp_path: Path, change: Change, wanted: str
) -> None:
    with pytest.raises(InputError, match=wanted) as caught:
        planned_tasks(plan(taken, tmp_path, change), EFFECTS, 0.02)
    assert caught.value.code == "plan_incomplete"
    assert "4 of 4 pictures are not there (f1-stretch-0.png, " in str(caught.value)


def test_what_is_not_stated_is_found_in_pictures_that_are_there(taken: CaptureSet, tmp_path: Path) -> None:
    there = CaptureSet(taken.folder, plan(taken, tmp_path, remove("density")).document)
    tasks, assumed = planned_tasks(there, EFFECTS, 0.02)
    assert tasks[1].parameters.density == TYPICAL_DENSITY_KG_M2
    assert "fabric f2: no density; taken as 0.2" in "; ".join(assumed)
    assert tasks[1].captures[0].depth.any()


def test_a_fabric_without_captures_need_not_be_known(taken: CaptureSet, tmp_path: Path) -> None:
    planned = plan(taken, tmp_path, lambda document: document["fabrics"].append({"id": "later"}))
    assert [task.id for task in planned_tasks(planned, EFFECTS, 0.02)[0]] == ["f1", "f2"]
