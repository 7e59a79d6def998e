"""Sweeps with the extended simulator that a diagnosis writes."""

from __future__ import annotations

import json
import pickle
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from diagnosis.extension import AppliedEffect, SimulatorExtension
from renderer.camera import CANONICAL_CAMERA
from renderer.store import Store
from services.cli.dataset import describe_simulator
from services.cli.main import run
from services.cli.simulate import build_scene as simulate_scene
from services.dataset.configuration import differences
from services.dataset.extension import build_scene
from services.dataset.fabrics import plan_sweep
from services.dataset.validation import validate_store
from services.jobs.kinds.dataset import DatasetInputs
from simcore.errors import InputError
from simcore.mechanics import FrozenCurvature, Mechanics
from simcore.parameters import FabricParameters
from simcore.scenes import Setup
from simcore.solver import Solver
from tests.services.dataset_helpers import small_sweep, write_without_ray
from tests.services.dataset_rows import made_up_store

HEM = AppliedEffect(name="hem_weight", size={"magnitude": 40.0})
DRAFT = AppliedEffect(name="air_draft", size={"magnitude": 0.4})
CLOTH = FabricParameters(1000.0, 800.0, 300.0, 1e-5, 2e-5, 1e-5, 0.2)
BASE = ["dataset", "--materials", "10", "--jitters", "1", "--inclinations", "2", "--resolution", "0.05", "--seed", "4"]
SMALL = [*BASE, "--shard-simulations", "3"]


def written(path: Path, *effects: AppliedEffect) -> Path:
    """A simulator file."""
    SimulatorExtension(effects=effects).save(path)
    return path


def test_a_heavy_hem_in_a_draft_makes_other_drapes_of_the_same_fabrics(tmp_path: Path) -> None:
    file = written(tmp_path / "simulator.json", HEM, DRAFT)
    plain = Store.open(write_without_ray(tmp_path / "a.zarr", *small_sweep(materials=1)))
    configuration, fabrics = small_sweep(materials=1, simulator=file)
    other = Store.open(write_without_ray(tmp_path / "b.zarr", configuration, fabrics))
    assert other.ok.all() and validate_store(other).valid
    assert np.array_equal(plain.parameters, other.parameters) and np.array_equal(
        plain.column("seed"), other.column("seed")
    )
    for simulation in range(2):
        moved = np.linalg.norm(plain.vertices(simulation) - other.vertices(simulation), axis=1)
        assert np.sqrt((moved**2).mean()) > 5e-3
    assert (plain.depth_counts(0) != other.depth_counts(0)).any()
    assert other.attributes["configuration"]["simulator"] == [effect.model_dump() for effect in (HEM, DRAFT)]
    # the row makes its drape again, with what the file says
    solver, fabric = Solver(configuration.mesh), FabricParameters.from_array(other.parameters[0])
    mechanics = Mechanics(hem_kg_m=0.04, air_pressure_pa=0.4)
    again = solver.solve(fabric, Setup.nominal("hanging"), seed=int(other.column("seed")[0]), mechanics=mechanics)
    assert np.array_equal(again.vertices.astype(np.float32), other.vertices(0))


def test_resuming_with_another_file_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, store = tmp_path / "simulator.json", tmp_path / "s.zarr"
    made_up_store(store, *small_sweep(simulator=written(file, HEM)))
    assert run([*SMALL, "--out", str(store), "--simulator", str(file), "--resume", "--json"]) == 0
    capsys.readouterr()
    written(file, AppliedEffect(name="hem_weight", size={"magnitude": 39.0}))
    for changed in (["--simulator", str(file)], []):
        assert run([*SMALL, "--out", str(store), "--resume", *changed]) == 2
        assert "other settings (simulator)" in capsys.readouterr().err


def test_a_store_from_before_effects_is_one_without() -> None:
    configuration, _ = plan_sweep(materials=3)
    stored = json.loads(configuration.model_dump_json(exclude={"simulator"}))
    assert differences(stored, configuration) == []
    assert differences(stored, plan_sweep(materials=3, simulator=[HEM])[0]) == ["simulator"]


@pytest.mark.parametrize(
    ("text", "code"),
    [
        (None, "file_unreadable"),
        ("{", "extension_invalid"),
        ('{"format": "drapemeter-simulator/2", "effects": []}', "extension_invalid"),
        ('{"format": "drapemeter-simulator/1", "effects": [], "pin_radius_m": -0.01}', "extension_invalid"),
        ('{"format": "drapemeter-simulator/1", "effects": [], "pin_radius_m": 0.4}', "extension_invalid"),
        ([("draught", {"magnitude": 1.0})], "effect_unknown"),
        ([("air_draft", {"force": 1.0})], "effect_component_unknown"),
        ([("hem_weight", {"magnitude": -9.0})], "mechanics"),
        ([("camera_rotation", {"rx": 1.0})], "simulator_moves_panel"),
        ([("depth_bias", {"magnitude": 0.005})], "simulator_moves_panel"),
        ([("air_draft", {"magnitude": 0.1}), ("air_draft", {"magnitude": 0.2})], "effect_twice"),
        ([("air_draft", {})], "effect_magnitude"),
    ],
)
def test_a_file_that_cannot_be_used_is_one_line_exit_2(
    text: Any, code: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "simulator.json"
    if isinstance(text, list):
        text = json.dumps(
            {"format": "drapemeter-simulator/1", "effects": [{"name": name, "size": size} for name, size in text]}
        )
    if text is not None:
        file.write_text(text)
    assert run([*SMALL, "--out", str(tmp_path / "new.zarr"), "--simulator", str(file)]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and lines[0].endswith(f"[{code}]")
    assert not (tmp_path / "new.zarr").exists()


def test_effects_of_every_stage_reach_the_simulation_and_its_pictures() -> None:
    effects = [
        AppliedEffect(name="pin_spacing", size={"magnitude": 0.01}),
        AppliedEffect(name="focal_scale", size={"magnitude": 0.02}),
        AppliedEffect(name="range_noise", size={"magnitude": 0.003}),
        AppliedEffect(name="bending_hysteresis", size={"magnitude": 8.0, "seed": 1.0}),
    ]
    configuration, _ = plan_sweep(materials=1, simulator=effects)
    first, same, other = (build_scene(configuration, "hanging", CLOTH, seed) for seed in (1, 1, 2))
    assert first == same
    assert first.setup.pins_m["top_left"][0] == pytest.approx(-0.205)
    assert first.camera == replace(CANONICAL_CAMERA, fx=320.0 * 1.02, fy=320.0 * 1.02)
    assert first.sensor.range_noise_m == 0.003
    frozen = [scene.mechanics.rest_curvature[0] for scene in (first, other)]
    assert all(isinstance(field, FrozenCurvature) and field.amplitude == 8.0 for field in frozen)
    assert frozen[0] != frozen[1], "each handling leaves another curvature"


def test_a_store_says_the_whole_of_a_place_that_was_given_in_part() -> None:
    """What a part means is not for later versions to decide of a store that is there."""
    given = [{"magnitude": 6.0, "warp": 1.0}, {"magnitude": 6.0}, {"magnitude": 6.0, "weft": 0.0, "warp": 1.0}]
    effects = [AppliedEffect(name="rest_curvature", size=size) for size in given]
    stored = [plan_sweep(materials=1, simulator=[effect])[0].simulator[0].size for effect in effects]
    assert stored == [given[2], given[1], given[2]]


def test_magnets_hold_as_the_file_says(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, store = tmp_path / "simulator.json", tmp_path / "s.zarr"
    SimulatorExtension(effects=(), pin_radius_m=0.0).save(file)
    points, _ = plan_sweep(materials=1, simulator=file)
    wide, _ = plan_sweep(materials=1, simulator=SimulatorExtension(effects=(DRAFT,), pin_radius_m=0.02))
    plain, _ = plan_sweep(materials=1)
    assert [build_scene(c, "stretch", CLOTH, 0).setup.pin_radius_m for c in (points, wide, plain)] == [0.0, 0.02, 0.01]
    assert differences(json.loads(plain.model_dump_json(exclude={"pin_radius_m"})), plain) == []
    assert differences(points.model_dump(mode="json"), plain) == ["pin_radius_m"]
    assert describe_simulator(points) == "simulated with --pin-radius 0"
    assert describe_simulator(wide) == "simulated with --effect air_draft=magnitude:0.4 --pin-radius 0.02"
    made_up_store(store, *small_sweep(simulator=file))
    SimulatorExtension(effects=(), pin_radius_m=0.02).save(file)
    assert run([*SMALL, "--out", str(store), "--resume", "--simulator", str(file)]) == 2
    assert "other settings (pin_radius_m)" in capsys.readouterr().err


def test_what_travels_is_small_and_the_driver_starts_no_solver() -> None:
    configuration, _ = plan_sweep(materials=1, simulator=[HEM, DRAFT])
    assert len(pickle.dumps(configuration)) < 3000
    program = (
        "import sys\n"
        "from diagnosis.extension import AppliedEffect\n"
        "from services.dataset.fabrics import plan_sweep\n"
        "import services.dataset.sweep, services.dataset.worker\n"
        "plan_sweep(materials=1, simulator=[AppliedEffect(name='crease', size={'magnitude': 0.5})])\n"
        "sys.exit('taichi' in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", program], check=True, timeout=60)


def test_a_request_takes_the_same_document() -> None:
    document = json.loads(SimulatorExtension(effects=(HEM,)).model_dump_json())
    configuration, _ = DatasetInputs.model_validate({"materials": 2, "simulator": document}).plan()
    assert configuration.simulator == (HEM,) and configuration.pin_radius_m is None
    held, _ = DatasetInputs.model_validate({"materials": 2, "simulator": {**document, "pin_radius_m": 0.0}}).plan()
    assert held.pin_radius_m == 0.0 and held.simulator == (HEM,)
    wrong = {**document, "effects": [{"name": "draught", "size": {"magnitude": 1.0}}]}
    with pytest.raises(InputError, match="unknown effect"):
        DatasetInputs.model_validate({"materials": 2, "simulator": wrong}).check()


def test_simulate_makes_the_scene_of_a_row_again() -> None:
    frozen = AppliedEffect(name="bending_hysteresis", size={"magnitude": 10.0, "seed": 1.0})
    extended = SimulatorExtension(effects=(HEM, frozen), pin_radius_m=0.02)
    configuration, _ = plan_sweep(materials=1, simulator=extended)
    said = describe_simulator(configuration)
    assert said == (
        "simulated with --effect hem_weight=magnitude:40 --effect bending_hysteresis=magnitude:10 --pin-radius 0.02"
    )
    options = [effect.option for effect in configuration.simulator]
    seed = 2**63 + 11  # as a row's may be
    _, by_hand = simulate_scene("stretch", options, CLOTH, seed, pictured=False, pin_radius_m=0.02)
    swept = build_scene(configuration, "stretch", CLOTH, seed)
    assert (by_hand.setup, by_hand.mechanics) == (swept.setup, swept.mechanics)


@pytest.mark.parametrize(
    ("name", "magnitude", "code"),
    [("pin_spacing", 1.0, "pins_apart"), ("range_noise", 0.9, "depth_unit"), ("dropout", 1.0, "simulator_blind")],
)
def test_effects_that_leave_nothing_to_simulate_or_to_see_are_refused_beforehand(
    name: str, magnitude: float, code: str
) -> None:
    with pytest.raises(InputError) as caught:
        plan_sweep(materials=1, simulator=[AppliedEffect(name=name, size={"magnitude": magnitude})])
    assert caught.value.code == code
