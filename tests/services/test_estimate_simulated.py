"""`drapemeter estimate --simulator` and `POST /v1/estimates` alike: captures that show what a diagnosis found."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import httpx
import pytest

from capture.capture_set import CAPTURES_FILE
from diagnosis.effects import parse_effect
from diagnosis.extension import AppliedEffect, SimulatorExtension
from diagnosis.indirect_estimate import STEPS
from diagnosis.synthesis import SynthesisPlan, draw_fabrics, make_capture_set
from diagnosis.tasks.fabric_task import BASE_SEEDS
from services.cli import main
from simcore.parameters import ESTIMATED_NAMES
from tests.services.analytic_store import failure, run_json
from tests.services.served import finished, serving
from trainer.shipped import DEFAULT_MODEL

NEARER = "pin_spacing=-0.008"
TURN = {"rx": 1.0, "ry": 0.0, "rz": 0.0}


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
        ('{"format": "drapemeter-simulator/1", "effects": []}', "extension_empty", "leave it away"),
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


def ask(client: httpx.Client, captures: Path, simulator: str, key: str | None = None, **setup: Any) -> httpx.Response:
    """For an estimate from the set's one picture."""
    document = json.loads((captures / CAPTURES_FILE).read_text())
    (capture,), (fabric,) = document["captures"], document["fabrics"]
    data = {
        "density": str(fabric["density"]),
        "camera": json.dumps(document["camera"]),
        "setup": json.dumps({**document["setup"], **setup}),
        "sensor": json.dumps(document["sensor"]),
        **({"simulator": simulator} if simulator else {}),
    }
    files = {"stretch": ("s.png", (captures / capture["depth"]).read_bytes())}
    headers = {"Idempotency-Key": key} if key else {}
    return client.post("/v1/estimates", data=data, files=files, headers=headers)


def test_the_service_finds_the_same_as_a_job(
    captures: Path, simulator: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (wanted,) = run_json(capsys, "estimate", str(captures), "--simulator", str(simulator))["fabrics"]
    content = simulator.read_text()
    with serving(tmp_path, "--model", str(DEFAULT_MODEL)) as running, running.client() as client:
        plain = ask(client, captures, "", "plain").json()
        answer = ask(client, captures, content, "simulated")
        assert answer.status_code == 202, answer.text
        job = finished(client, answer.headers["location"])
        again = ask(client, captures, content, "simulated")
        other = ask(client, captures, content, "plain")
    assert (job["kind"], job["status"], job["problem"], job["progress"]) == ("estimate", "succeeded", None, 1.0)
    found = job["result"]
    assert found["parameters"] == pytest.approx(wanted["parameters"], rel=1e-6)
    assert found["simulated"]["without_effects"] == pytest.approx(plain["parameters"], rel=1e-6)
    assert found["simulated"]["simulations"] == wanted["simulated"]["simulations"]
    assert found["simulator"] == json.loads(content)
    assert set(plain) <= set(found) and found["density"] == wanted["density"] and found["notes"] == []
    assert again.json()["id"] == job["id"] and again.headers["idempotent-replayed"] == "true"
    assert other.json()["code"] == "idempotency_key_reused"


def adding(**effects: dict[str, float]) -> str:
    """A simulator file of effects by their name."""
    listed = [{"name": name, "size": size} for name, size in effects.items()]
    return json.dumps({"format": "drapemeter-simulator/1", "effects": listed})


@pytest.mark.parametrize(
    ("simulator", "setup", "code", "words"),
    [
        ("{", {}, "simulator_invalid", "not valid JSON"),
        ('{"format": "drapemeter-simulator/1"}', {}, "simulator_invalid", "simulator.effects: Field required"),
        (adding(), {}, "extension_empty", "adds nothing"),
        (adding(pin_spacing={"magnitude": math.nan}), {}, "simulator_invalid", "not a finite number"),
        (adding(pin_spacing={"length": 0.01}), {}, "effect_component_unknown", "choose from magnitude"),
        (adding(nonsense={"magnitude": 1.0}), {}, "effect_unknown", "nonsense"),
        (adding(camera_rotation=TURN), {"camera_from_panel": None}, "effects_in_poses", "the poses are found"),
        (adding(pin_spacing={"magnitude": -0.008}), {"pin_radius_m": 0.3}, "pin_radius", "'stretch-0'"),
    ],
)
def test_what_cannot_be_simulated_is_refused_at_once(
    simulator: str, setup: dict[str, Any], code: str, words: str, captures: Path, client: httpx.Client
) -> None:
    answer = ask(client, captures, simulator, **setup)
    assert (answer.status_code, answer.json()["code"]) == (422, code), answer.text
    assert words in answer.json()["detail"]
