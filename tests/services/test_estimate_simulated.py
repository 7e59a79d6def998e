"""`drapemeter estimate --simulator`: captures that show what a diagnosis found."""

from __future__ import annotations

from pathlib import Path

import pytest

from diagnosis.effects import parse_effect
from diagnosis.extension import AppliedEffect, SimulatorExtension
from diagnosis.indirect_estimate import STEPS
from diagnosis.synthesis import SynthesisPlan, draw_fabrics, make_capture_set
from diagnosis.tasks.fabric_task import BASE_SEEDS
from services.cli import main
from simcore.parameters import ESTIMATED_NAMES
from tests.services.analytic_store import failure, run_json

NEARER = "pin_spacing=-0.008"


@pytest.fixture(scope="module")
def captures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One fabric in `stretch`, the magnets too near to each other."""
    plan = SynthesisPlan(fabrics=1, scenes=("stretch",), resolution_m=0.02, repeats=1, pin_radius_m=0.01, seed=41)
    folder = tmp_path_factory.mktemp("near") / "set"
    return make_capture_set(folder, plan, [parse_effect(NEARER)], fabrics=dict(enumerate(draw_fabrics(1, 41)))).folder


@pytest.fixture(scope="module")
def simulator(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """As `drapemeter diagnose --apply` writes it."""
    effect, size = parse_effect(NEARER)
    path = tmp_path_factory.mktemp("report") / "simulator.json"
    SimulatorExtension(effects=(AppliedEffect(name=effect.name, size=effect.size(size)),)).save(path)
    return path


def test_estimates_are_of_simulations_with_the_effects(
    captures: Path, simulator: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plain = run_json(capsys, "estimate", str(captures))["fabrics"][0]
    document = run_json(capsys, "estimate", str(captures), "--simulator", str(simulator))
    (fabric,) = document["fabrics"]
    assert fabric["simulated"]["without_effects"] == plain["parameters"] != fabric["parameters"]
    assert fabric["simulated"]["simulations"] == (STEPS + 1) * BASE_SEEDS["stretch"]
    assert fabric["simulated"]["not_at_rest"] == 0 and 0.0 <= fabric["simulated"]["left"] < 1.0
    assert document["simulator"] == SimulatorExtension.load(simulator).model_dump(mode="json")
    for name in ESTIMATED_NAMES:
        low, high = fabric["intervals_90"][name]
        assert low < fabric["parameters"][name] < high
        first_low, first_high = plain["intervals_90"][name]
        assert high / low >= 0.999 * first_high / first_low
    assert main.run(["estimate", str(captures), "--simulator", str(simulator)]) == 0
    said = capsys.readouterr().out
    assert said.count("without the effects") == len(ESTIMATED_NAMES)
    assert f"  {(STEPS + 1) * BASE_SEEDS['stretch']} simulations with the effects: the network's word" in said


@pytest.mark.parametrize(
    ("content", "code", "words"),
    [
        ('{"format": "drapemeter-simulator/1", "effects": []}', "extension_empty", "leave --simulator out"),
        ("{}", "extension_invalid", "drapemeter diagnose --apply"),
        (None, "file_unreadable", "cannot be read"),
    ],
)
def test_a_simulator_that_is_none_is_refused(
    content: str | None, code: str, words: str, captures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "simulator.json"
    if content is not None:
        path.write_text(content)
    status, said = failure(capsys, "estimate", str(captures), "--simulator", str(path))
    assert status == 2 and words in said and said.endswith(f"[{code}]")
