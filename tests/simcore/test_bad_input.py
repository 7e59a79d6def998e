"""What cannot be simulated is refused in one line that says what to do, before anything is solved."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from metric.library import load_library
from simcore.checks import seed_sequence
from simcore.drape import Drape
from simcore.errors import DrapemeterError, InputError
from simcore.mechanics import (
    LARGEST,
    LARGEST_JITTER,
    NO_JITTER,
    Crease,
    EdgeCurl,
    FrozenCurvature,
    Jitter,
    Mechanics,
    UniformCurvature,
)
from simcore.mesh import GridMesh
from simcore.newton import FACTORISATIONS
from simcore.parameters import LIMITS, PARAMETER_NAMES, FabricParameters
from simcore.placement import Perturbation, Pins, put_up
from simcore.sampling_tables import read_fabric_list
from simcore.scenes import Scene, Setup
from simcore.solver import Solver

from .rigs import FABRICS, Level, Newton, NewtonOptions, Rig, strip

MEDIUM = FABRICS["medium"]
HANGING = Setup.nominal(Scene.HANGING)


def refused(work: Callable[[], Any], *words: str) -> InputError:
    """The error, checked for being one line that names the words."""
    with pytest.raises(InputError) as caught:
        work()
    message = str(caught.value)
    assert "\n" not in message and len(message) < 300
    assert all(word in message for word in words), message
    assert caught.value.code.replace("_", "").isalnum() and caught.value.code.islower()
    assert isinstance(caught.value, DrapemeterError)
    return caught.value


@pytest.mark.parametrize("name", PARAMETER_NAMES)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 0.0, -1.0, 1e9, 1e-12])
def test_values_that_no_fabric_has(name: str, value: float) -> None:
    error = refused(lambda: replace(MEDIUM, **{name: value}), name)
    assert error.code == "parameter_out_of_range"


@pytest.mark.parametrize("value", ["0.2", None, True, [0.2], 1 + 2j])
def test_values_that_are_no_numbers(value: object) -> None:
    assert refused(lambda: replace(MEDIUM, density=value), "density").code == "parameter_not_a_number"


def test_a_gram_for_a_kilogram_is_noticed() -> None:
    refused(lambda: replace(MEDIUM, density=200.0), "density", "kg/m²")
    refused(lambda: replace(MEDIUM, bending_warp=15.0), "bending_warp", "N·m")


def test_vectors_and_files_that_are_no_fabric(tmp_path: Path) -> None:
    assert refused(lambda: FabricParameters.from_array([1.0, 2.0]), "seven").code == "bad_input"
    refused(lambda: FabricParameters.from_mapping({"density": 0.2}), "stretch_warp")
    refused(lambda: FabricParameters.load(tmp_path / "none.json"), "no such file")
    for text, word in (("{", "JSON"), ("[1]", "object"), ('{"density": "x"}', "lack")):
        path = tmp_path / "p.json"
        path.write_text(text)
        refused(lambda path=path: FabricParameters.load(path), word)


def test_limits_themselves_are_allowed() -> None:
    for name, (low, high) in LIMITS.items():
        assert getattr(replace(MEDIUM, **{name: low}), name) == low
        assert getattr(replace(MEDIUM, **{name: high}), name) == high


@pytest.mark.parametrize("resolution", [0.03, 0.0077, 0.07])
def test_a_resolution_that_does_not_divide_the_sample(resolution: float) -> None:
    error = refused(lambda: GridMesh(resolution), "divide")
    assert error.code == "resolution_does_not_divide"
    suggested = float(str(error).rsplit(" ", 1)[-1])
    GridMesh(suggested)  # what it says to try works


@pytest.mark.parametrize(
    ("size_m", "nearest"), [((0.3, 0.4), 0.1 / 3), ((0.42, 0.594), 0.006), ((0.29, 0.31), 0.01), ((0.5, 0.7071), None)]
)
def test_a_resolution_that_divides_both_sides_is_advised(size_m: tuple[float, float], nearest: float | None) -> None:
    error = refused(lambda: GridMesh(0.03, size_m), "divide")
    if nearest is None:
        assert "no cell" in str(error)
        return
    suggested = float(str(error).rsplit(" ", 1)[-1])
    assert suggested == pytest.approx(nearest)
    GridMesh(suggested, size_m)


def test_half_a_metre_in_millimetres_is_the_finest() -> None:
    assert GridMesh(0.001).vertex_count == 251_001


@pytest.mark.parametrize(("cell_m", "size_m"), [(0.001, (5.0, 5.0)), (0.001, (0.6, 0.6)), (0.0013, (2.0, 3.0))])
def test_a_mesh_that_no_machine_brings_to_rest(cell_m: float, size_m: tuple[float, float]) -> None:
    error = refused(lambda: GridMesh(cell_m, size_m), "vertices", "300,000", "try")
    assert error.code == "mesh_too_large"
    suggested = float(str(error).rsplit(" ", 1)[-1])
    assert suggested > cell_m and 150_000 < GridMesh(suggested, size_m).vertex_count <= 300_000


@pytest.mark.parametrize("size_m", [(1e308, 1e308), (1e9, 0.5), (100.0, 100.0)])
def test_samples_that_no_cell_cuts_into_few(size_m: tuple[float, float]) -> None:
    assert refused(lambda: GridMesh(0.05, size_m), "cut it up").code == "mesh_too_large"


@pytest.mark.parametrize("length", [0.0, -0.5, math.nan, math.inf])
def test_a_sample_without_a_size(length: float) -> None:
    assert refused(lambda: GridMesh(0.01, (length, 0.5)), "sample size").code == "sample_size"


@pytest.mark.parametrize("resolution", [0.0, -0.01, math.nan, math.inf, 1e-5, 0.4])
def test_resolutions_that_are_absurd(resolution: float) -> None:
    assert refused(lambda: GridMesh(resolution), "resolution").code == "resolution_out_of_range"


def test_pins_stand_in_one_order_whatever_the_document_s() -> None:
    given = dict(reversed(Setup.nominal(Scene.STRETCH).pins_m.items()))
    assert list(Setup(Scene.STRETCH, pins_m=given).pins_m) == ["top_left", "top_right", "bottom_right"]


def test_scenes_and_set_ups() -> None:
    assert refused(lambda: Setup.nominal("lying"), "lying", "hanging").code == "scene_unknown"
    assert refused(lambda: replace(HANGING, pin_radius_m=0.3), "pin radius").code == "pin_radius"
    assert refused(lambda: replace(HANGING, pin_radius_m=math.nan), "pin radius").code == "pin_radius"
    assert refused(lambda: replace(HANGING, sample_size_m=(0.5, -0.5)), "sample size").code == "sample_size"
    assert refused(lambda: replace(HANGING, sample_size_m=(0.5, math.nan)), "sample size").code == "sample_size"
    assert refused(lambda: Setup(Scene.STRETCH, pins_m=HANGING.pins_m), "bottom_right").code == "pins_missing"
    assert refused(lambda: HANGING.with_pins(middle=(0.0, 0.0, 0.0)), "and no middle").code == "pins_missing"
    for place in ((math.nan, 0.0, 0.0), (0.0, 0.0), (math.inf, 0.0, 0.0)):
        error = refused(lambda place=place: HANGING.with_pins(top_left=place), "top_left", "three finite coordinates")
        assert error.code == "pin_position"


@pytest.mark.parametrize(
    ("place", "code"),
    [
        ((0.2, 0.0, 0.0), "pins_overlap"),
        ((0.185, 0.0, 0.0), "pins_overlap"),
        ((0.3, 0.0, 0.0), "pins_crossed"),
        ((-0.2, 0.0, -0.01), "pin_behind_panel"),
        ((-3.0, 0.0, 0.0), "pins_apart"),
        ((-0.2, 40.0, 0.0), "pin_far"),
        ((-0.2, 1.0, 0.0), "pins_apart"),
    ],
)
def test_pins_where_no_sample_can_be_pinned(place: tuple[float, float, float], code: str, solver: Solver) -> None:
    """Behind the panel, in one place, the wrong way round, or so far apart that the cloth between would tear."""
    assert refused(lambda: solver.solve(MEDIUM, HANGING.with_pins(top_left=place)), "pin", "top_left").code == code


def test_pins_on_another_panel(solver: Solver) -> None:
    """All shifted alike, the cloth between them is whole; y counted downwards turns it over."""
    away = HANGING.with_pins(**{name: (x + 40.0, y, z) for name, (x, y, z) in HANGING.pins_m.items()})
    assert refused(lambda: solver.solve(MEDIUM, away), "top_left", "metres").code == "pin_far"
    stretched = Setup.nominal(Scene.STRETCH)
    x, y, z = stretched.pins_m["bottom_right"]
    over = stretched.with_pins(bottom_right=(x, -y, z))
    assert refused(lambda: solver.solve(MEDIUM, over), "bottom_right", "y points up").code == "pins_crossed"


@pytest.mark.parametrize("seed", [-1, 1.5, "one", "1", None, True, [1, None], (2, False), np.array([True]), [1.0]])
def test_a_seed_that_is_none(seed: Any, solver: Solver) -> None:
    assert refused(lambda: solver.solve(MEDIUM, HANGING, seed=seed), "whole number").code == "seed_negative"


def test_seeds_that_are_some() -> None:
    for seed in (0, np.int64(3), (1, 2), [1, (2, 3)], np.array([4, 5]), 2**200):
        assert (
            seed_sequence(seed).generate_state(2).tobytes() == np.random.SeedSequence(seed).generate_state(2).tobytes()
        )


def test_mechanics_without_meaning() -> None:
    for change in (
        {"air_pressure_pa": math.nan},
        {"gravity": (0.0, 0.0, 0.0)},
        {"gravity": (0.0, math.inf, 0.0)},
        {"gravity": (0.0, -9.81)},
        {"gravity": (0.0, -9.81, 0.0, 0.0)},
        {"gravity": (0.0, -0.009, 0.0)},
        {"off_grain_rad": -3.2},
        {"stiffening_strain": 0.0},
        {"stiffening_strain": -0.1},
        {"stiffening_strain": math.nan},
        {"hem_kg_m": -0.1},
        {"trim_kg_m": (0.0, -0.1, 0.0, 0.0)},
        {"trim_kg_m": (0.0, 0.0, math.nan, 0.0)},
        {"trim_kg_m": (0.1,)},
        {"adhesion_pa": -1.0},
        {"adhesion_range_m": 0.0},
        {"adhesion_range_m": math.inf},
        {"friction": -0.1},
        {"friction": math.nan},
    ):
        assert refused(lambda change=change: Mechanics(**change)).code == "mechanics"


def test_a_range_of_adhesion_that_is_none() -> None:
    assert "without adhesion" in str(refused(lambda: Mechanics(adhesion_range_m=0.0), "adhesion_range_m = 0"))


@pytest.mark.parametrize("name", LARGEST_JITTER)
def test_a_jitter_in_another_unit(name: str) -> None:
    Jitter(**{name: LARGEST_JITTER[name]})
    for size in (1.01 * LARGEST_JITTER[name], -1e-9, math.nan, math.inf):
        assert refused(lambda size=size: Jitter(**{name: size}), name, "unit").code == "mechanics"


@pytest.mark.parametrize("name", LARGEST)
def test_mechanics_in_another_unit(name: str) -> None:
    def make(size: float) -> Mechanics:
        if name == "gravity_m_s2":
            return Mechanics(gravity=(0.0, -size, 0.0))
        return Mechanics(**{name: (0.0, size, 0.0, 0.0) if name == "trim_kg_m" else size})

    make(LARGEST[name])
    assert refused(lambda: make(1.01 * LARGEST[name]), name, "unit").code == "mechanics"


@pytest.mark.parametrize(
    "make",
    [
        lambda: UniformCurvature(math.nan),
        lambda: EdgeCurl(math.inf),
        lambda: EdgeCurl(10.0, edges=("lft",)),
        lambda: Crease(math.nan),
        lambda: Crease(0.5, along="wrap"),
        lambda: FrozenCurvature(math.nan),
        lambda: FrozenCurvature(1.0, wavelength_m=0.0),
        lambda: UniformCurvature(weft=-1e5),
        lambda: Crease(45.0),
        lambda: Jitter(pin_m=-0.001),
        lambda: Jitter(force_weights=math.nan),
    ],
)
def test_fields_and_jitter_without_meaning(make: Callable[[], object]) -> None:
    assert refused(make).code == "mechanics"


def test_a_mesh_of_another_sample(solver: Solver) -> None:
    small = Setup.nominal(Scene.HANGING, sample_size_m=(0.4, 0.5))
    refused(lambda: solver.solve(MEDIUM, small), "0.4", "0.5")


def test_a_start_from_another_mesh(solver: Solver, drapes: dict[tuple[str, Scene], Drape]) -> None:
    other = replace(drapes["medium", Scene.HANGING], mesh=GridMesh(0.05))
    error = refused(lambda: solver.solve(MEDIUM, HANGING, start=other), "mesh")
    assert error.code == "mesh_mismatch"


def test_a_start_that_is_no_drape(solver: Solver, drapes: dict[tuple[str, Scene], Drape]) -> None:
    good = drapes["medium", Scene.HANGING]
    broken = replace(good, vertices=np.full_like(good.vertices, np.nan))
    error = refused(lambda: solver.solve(MEDIUM, HANGING, start=broken), "finite", "start afresh")
    assert error.code == "start_not_finite"
    short = replace(good, vertices=good.vertices[:-1])
    assert refused(lambda: solver.solve(MEDIUM, HANGING, start=short), "vertices").code == "mesh_mismatch"


@pytest.mark.parametrize("limit", [-1.0, math.nan])
def test_a_time_limit_that_is_none(limit: float, solver: Solver) -> None:
    error = refused(lambda: solver.solve(MEDIUM, HANGING, time_limit_s=limit), "time limit", "0 or more, or None")
    assert error.code == "time_limit"


def test_newton_ends_on_positions_that_are_not_finite() -> None:
    rig = Rig.of(strip(0.2, 0.1, 0.02), FABRICS["soft"], np.zeros((6, 11), dtype=bool))
    x = rig.level.grid.rest.copy()
    x[2, 2] = math.nan
    rest = Newton(rig.level, NewtonOptions()).minimise(x)
    assert not rest.converged and not rest.stable


class NeverPositive:
    """In place of a level's ``factor``: counts how often it is asked."""

    def __init__(self) -> None:
        self.asked = 0

    def __call__(self, *_: object, **__: object) -> int:
        self.asked += 1
        return 1


def hung(monkeypatch: pytest.MonkeyPatch) -> tuple[Level, Pins, NeverPositive]:
    """A sample whose Hessian is never positive."""
    rig = Rig.of(strip(0.2, 0.1, 0.02), FABRICS["soft"], np.zeros((6, 11), dtype=bool))
    factor = NeverPositive()
    monkeypatch.setattr(rig.level, "factor", factor)
    setup = Setup.nominal(Scene.HANGING, sample_size_m=(0.2, 0.1))
    return rig.level, Pins.of(rig.level.grid, setup, np.zeros((2, 3))), factor


def test_newton_ends_where_no_damping_makes_the_hessian_positive(monkeypatch: pytest.MonkeyPatch) -> None:
    level, _, factor = hung(monkeypatch)
    rest = Newton(level, NewtonOptions()).minimise(level.grid.rest.copy())
    assert not rest.converged and rest.iterations == 0 and factor.asked == FACTORISATIONS
    looks = itertools.count()
    monkeypatch.setattr(time, "process_time", lambda: float(next(looks)))
    rest = Newton(level, NewtonOptions(), deadline=4.0).minimise(level.grid.rest.copy())
    assert not rest.converged and factor.asked == FACTORISATIONS + 5


def test_putting_up_ends_where_no_shift_makes_the_hessian_positive(monkeypatch: pytest.MonkeyPatch) -> None:
    level, pins, factor = hung(monkeypatch)
    flat = Perturbation(np.zeros((2, 3)), np.zeros((4, 4, 4)), NO_JITTER)
    x, steps = put_up(level, pins, flat)
    assert steps == 0 and np.isfinite(x).all() and factor.asked == FACTORISATIONS
    looks = itertools.count()
    monkeypatch.setattr(time, "process_time", lambda: float(next(looks)))
    assert put_up(level, pins, flat, deadline=3.0)[1] == 0
    assert factor.asked == FACTORISATIONS + 4


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Crease(1.0, position=7.0), ("crease", "0 to 1")),
        (lambda: Crease(1.0, width_m=0.002), ("crease", "0.002 m", "0.0025")),  # it would be missed, or count twice
        (lambda: EdgeCurl(10.0, width_m=0.0), ("strip", "0.0025")),
        (lambda: EdgeCurl(10.0, width_m=math.nan), ("strip", "0.0025")),
        (lambda: EdgeCurl(10.0, width_m=30.0), ("strip", "30 m", "to 5 m")),
        (lambda: EdgeCurl(10.0, edges="left"), ("tuple of names", "'left'")),  # type: ignore[arg-type]
        (lambda: FrozenCurvature(10.0, seed=-1), ("seed", "-1")),
        (lambda: FrozenCurvature(10.0, seed=math.nan), ("whole number", "nan")),  # type: ignore[arg-type]
        (lambda: FrozenCurvature(10.0, wavelength_m=0.001), ("waves", "0.0025")),
        (lambda: FrozenCurvature(10.0, seed=1.5), ("whole number", "1.5")),  # type: ignore[arg-type]
        (lambda: Mechanics(rest_curvature=EdgeCurl(10.0)), ("tuple of fields",)),  # type: ignore[arg-type]
        (lambda: Mechanics(stiffening_strain=1e-200), ("stiffening", "positive")),
    ],
)
def test_rest_curvatures_that_no_sample_has(make: Callable[[], Any], words: tuple[str, ...]) -> None:
    assert refused(make, *words).code == "mechanics"


@pytest.mark.parametrize(
    ("text", "word"), [("[" * 100_000, "nested"), ('{"density": ' + "1" * 5000 + "}", "digits"), ("{", "line 1")]
)
def test_json_that_cannot_be_read(tmp_path: Path, text: str, word: str) -> None:
    (tmp_path / "p.json").write_text(text)
    for read in (FabricParameters.load, load_library, read_fabric_list):
        assert refused(lambda read=read: read(tmp_path / "p.json"), "p.json", word).code == "file_not_json"


def test_a_whole_number_that_no_float_holds() -> None:
    assert refused(lambda: replace(MEDIUM, density=10**400), "density").code == "parameter_out_of_range"
