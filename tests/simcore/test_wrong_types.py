"""What is no number, or not so many of them, is refused as a number out of range is; whole numbers and NumPy's do."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from diagnosis.effects import parse_effect
from diagnosis.scene import SimulationScene
from diagnosis.simulation.drape_cache import _plain
from simcore.checks import check_request
from simcore.mechanics import (
    Crease,
    EdgeCurl,
    FrozenCurvature,
    Jitter,
    Mechanics,
    UniformCurvature,
)
from simcore.mesh import GridMesh
from simcore.scenes import Scene, Setup

from .test_bad_input import HANGING, refused

NO_NUMBERS = [
    "0.01",
    None,
    True,
    [0.01],
    1j,
    pytest.param(10**400, id="hundreds of digits"),
    pytest.param(10**5000, id="thousands of digits"),
]
SINGLE = (
    "air_pressure_pa",
    "off_grain_rad",
    "hem_kg_m",
    "adhesion_pa",
    "adhesion_range_m",
    "friction",
)


@pytest.mark.parametrize("value", NO_NUMBERS)
@pytest.mark.parametrize("name", SINGLE)
def test_mechanics_of_no_number(name: str, value: object) -> None:
    change: dict[str, Any] = {name: value}
    assert refused(lambda: Mechanics(**change), name, "number").code == "mechanics"


@pytest.mark.parametrize("value", ["0.03", True, [0.03], 1j, math.nan, pytest.param(10**400, id="digits")])
def test_a_stiffening_of_no_number(value: Any) -> None:
    assert refused(lambda: Mechanics(stiffening_strain=value), "stiffening_strain", "None").code == "mechanics"


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("gravity", ("a", 0, 0)),
        ("gravity", "abc"),
        ("gravity", None),
        ("gravity", 9.81),
        ("gravity", (0.0, True, -9.81)),
        ("gravity", np.array(9.81)),
        ("gravity", np.zeros((3, 1))),
        ("trim_kg_m", None),
        ("trim_kg_m", 0.1),
        ("trim_kg_m", ("0.1", 0.0, 0.0, 0.0)),
        ("trim_kg_m", {"left": 0.1, "right": 0.0, "top": 0.0, "bottom": 0.0}),
        ("rest_curvature", (3,)),
        ("rest_curvature", (UniformCurvature(1.0), None)),
        ("rest_curvature", (EdgeCurl,)),
    ],
)
def test_mechanics_of_something_else(name: str, value: object) -> None:
    change: dict[str, Any] = {name: value}
    assert refused(lambda: Mechanics(**change), name).code == "mechanics"


@pytest.mark.parametrize("value", NO_NUMBERS)
@pytest.mark.parametrize(
    "make",
    [
        lambda value: UniformCurvature(weft=value),
        lambda value: EdgeCurl(value),
        lambda value: EdgeCurl(3.0, width_m=value),
        lambda value: Crease(value),
        lambda value: Crease(1.0, position=value),
        lambda value: Crease(1.0, width_m=value),
        lambda value: FrozenCurvature(value),
        lambda value: FrozenCurvature(1.0, wavelength_m=value),
    ],
)
def test_rest_curvatures_of_no_number(make: Callable[[Any], object], value: object) -> None:
    assert refused(lambda: make(value), "number").code == "mechanics"


def test_a_stiffening_at_an_infinite_strain_never_comes() -> None:
    assert Mechanics(stiffening_strain=math.inf).stiffening_strain == math.inf


@pytest.mark.parametrize("value", NO_NUMBERS)
def test_jitters_of_no_number(value: Any) -> None:
    for name in ("force_weights", "pin_m", "placement_m"):
        assert refused(lambda name=name: Jitter(**{name: value}), name, "number").code == "mechanics"


@pytest.mark.parametrize("value", ["1", None, True, [1], 1j])
def test_seeds_of_curvature_that_are_no_number(value: Any) -> None:
    assert refused(lambda: FrozenCurvature(1.0, seed=value), "seed", "whole number").code == "mechanics"


@pytest.mark.parametrize("edges", [None, 3, "left"])
def test_edges_that_are_no_names(edges: Any) -> None:
    assert refused(lambda: EdgeCurl(3.0, edges=edges), "tuple of names").code == "mechanics"
    assert refused(lambda: EdgeCurl(3.0, edges=(edges, [])), "choose of left").code == "mechanics"


@pytest.mark.parametrize("value", NO_NUMBERS)
def test_meshes_and_set_ups_of_no_number(value: Any) -> None:
    assert refused(lambda: GridMesh(value), "resolution", "number").code == "resolution_out_of_range"
    assert refused(lambda: GridMesh(0.01, value), "sample size").code == "sample_size"
    assert refused(lambda: GridMesh(0.01, (0.5, value)), "sample size").code == "sample_size"
    assert refused(lambda: Setup.nominal("hanging", pin_radius_m=value), "pin_radius_m").code == "pin_radius"
    for size in (value, (0.5, value), (0.5,), (0.5, 0.5, 0.5)):
        error = refused(lambda size=size: Setup("hanging", size, HANGING.pins_m), "sample size", "height")  # type: ignore[arg-type]
        assert error.code == "sample_size"
    for place in (value, (value, 0.0, 0.0), 0.1, "abc", {"x": 0.0, "y": 0.0, "z": 0.0}):
        error = refused(lambda place=place: HANGING.with_pins(top_left=place), "top_left", "three finite coordinates")
        assert error.code == "pin_position"


@pytest.mark.parametrize("pins", [None, 3, ["top_left", "top_right"], {1: (0.0, 0.0, 0.0), None: (0.0, 0.0, 0.0)}])
def test_pins_without_names(pins: Any) -> None:
    assert refused(lambda: Setup(Scene.HANGING, pins_m=pins), "pins").code == "pins_missing"


@pytest.mark.parametrize("limit", ["5", True, [1.0]])
def test_a_time_limit_of_no_number(limit: Any) -> None:
    error = refused(lambda: check_request(GridMesh(0.05), HANGING, None, limit), "time limit", "or None")
    assert error.code == "time_limit"


def test_whole_numbers_and_numpy_s_are_numbers() -> None:
    one = Mechanics((0, -9, 0), 0, np.float32(0.5), 1, (UniformCurvature(np.int64(2)),), hem_kg_m=np.float64(0.1))
    assert one == Mechanics((0.0, -9.0, 0.0), 0.0, 0.5, 1.0, (UniformCurvature(2.0),), hem_kg_m=0.1)
    assert GridMesh(np.float64(0.05), (1, 1)).vertex_count == 441
    assert np.array_equal(Mechanics(gravity=np.array([0, -9.81, 0])).gravity, (0.0, -9.81, 0.0))  # type: ignore[arg-type]
    assert Jitter(1, np.float64(0.001), 0) == Jitter(1.0, 0.001, 0.0)


def test_a_scene_may_be_named() -> None:
    nominal = Setup.nominal(Scene.STRETCH)
    named = Setup("stretch", pins_m=nominal.pins_m)  # type: ignore[arg-type]
    assert named == nominal and named.scene is Scene.STRETCH
    assert json.dumps(named, default=_plain) == json.dumps(nominal, default=_plain)  # what names kept drapes
    assert refused(lambda: Setup("lying", pins_m=nominal.pins_m), "lying", "hanging").code == "scene_unknown"  # type: ignore[arg-type]


def test_an_effect_moves_the_corner_of_a_scene_that_was_named() -> None:
    nominal = Setup.nominal(Scene.STRETCH)
    effect, size = parse_effect("corner_pull=0.004")
    moved = [
        effect.apply(SimulationScene(setup), size).setup.pins_m["bottom_right"]
        for setup in (nominal, Setup("stretch", pins_m=nominal.pins_m))  # type: ignore[arg-type]
    ]
    assert moved[0] == moved[1] != nominal.pins_m["bottom_right"]
