"""Parameters that were estimated from captures are estimated again with what was named (decision 049)."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import NamedTuple, cast

import pytest

from capture.capture_set import CAPTURES_FILE, CaptureSet
from diagnosis import diagnose as whole
from diagnosis.anew import NO_MORE, WORTH, Anew, estimated_anew, says_more
from diagnosis.atlas import forecast
from diagnosis.diagnose import Diagnosis, DiagnosisOptions, diagnose
from diagnosis.effects import parse_effect
from diagnosis.extension import AppliedEffect, SimulatorExtension
from diagnosis.gathering import cost_of
from diagnosis.indirect_estimate import IndirectEstimate, IndirectEstimator
from diagnosis.report import GapReport
from diagnosis.simulation.drape_cache import DrapeCache
from diagnosis.simulation.simulator import Cost, KeyedDrape, Simulator
from diagnosis.tasks.fabric_task import FabricTask
from diagnosis.tasks.parameters import uncertainty
from diagnosis.tasks.preparation import prepare_tasks
from simcore.drape import Drape
from simcore.errors import SimulationError
from simcore.parameters import ESTIMATED_NAMES
from tests.diagnosis.conftest import PLAN, MakeSet
from trainer.predict import Estimate

CELL_M = PLAN.resolution_m
OPTIONS = DiagnosisOptions(effects=("air_draft",), resolution_m=CELL_M)
DRAFT, SIZE = parse_effect("air_draft=0.3")
FOUND = SimulatorExtension(effects=(AppliedEffect(name=DRAFT.name, size=DRAFT.size(SIZE)),))


def without_parameters(captures: CaptureSet, *fabrics: str) -> CaptureSet:
    """The same set with some fabrics' parameters withheld."""
    path = captures.folder / CAPTURES_FILE
    document = json.loads(path.read_text())
    for fabric in document["fabrics"]:
        if fabric["id"] in fabrics:
            fabric.update(parameters=None, parameters_cv=None)
    path.write_text(json.dumps(document))
    return CaptureSet.load(captures.folder)


@pytest.fixture(scope="module")
def withheld(make_set: MakeSet) -> CaptureSet:
    """Two fabrics in a draft, no parameters."""
    return without_parameters(make_set("air_draft=0.3"), "f1", "f2")


@pytest.fixture(scope="module")
def tasks(withheld: CaptureSet) -> list[FabricTask]:
    return prepare_tasks(withheld, ("air_draft",), CELL_M)[0]


def answers(times: float, monkeypatch: pytest.MonkeyPatch) -> list[Estimate]:
    """Estimates with effects are so many times the first in ``bending_weft``."""
    given: list[Estimate] = []

    def estimate(indirect: IndirectEstimator, fabric: str, density: float) -> SimpleNamespace:
        first = indirect.estimator.estimate(indirect._inputs[fabric], density)
        parameters = {**first.parameters, "bending_weft": times * first.parameters["bending_weft"]}
        low, high = first.intervals_90["bending_weft"]
        intervals = {**first.intervals_90, "bending_weft": (times * low, times * high)}
        given.append(replace(first, parameters=parameters, intervals_90=intervals))
        return SimpleNamespace(estimate=given[-1])

    monkeypatch.setattr(IndirectEstimator, "estimate", estimate)
    return given


def test_tasks_have_what_is_estimated_with_the_effects(
    withheld: CaptureSet, tasks: list[FabricTask], shelf: DrapeCache, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = answers(3.0, monkeypatch)
    anew = estimated_anew(withheld, tasks, FOUND, shelf, CELL_M)
    assert [task.id for task in anew.tasks] == ["f1", "f2"]
    for task, before, estimate in zip(anew.tasks, tasks, given, strict=True):
        assert task.parameters.as_dict() == {**estimate.parameters, "density": before.parameters.density}
        assert task.relative_sigma == (*uncertainty(estimate), before.relative_sigma[-1])
        assert task.estimated and task.captures is before.captures
    assert anew.said[0].startswith("fabric f1: estimated again with air_draft in the simulations")
    assert "bending_weft 3," in anew.said[0] and "stretch_warp 1," in anew.said[0]


def test_fabrics_that_state_parameters_keep_them(
    make_set: MakeSet, shelf: DrapeCache, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers(3.0, monkeypatch)
    some = without_parameters(make_set("air_draft=0.3"), "f2")
    before = prepare_tasks(some, ("air_draft",), CELL_M)[0]
    anew = estimated_anew(some, before, FOUND, shelf, CELL_M)
    assert anew.tasks[0] is before[0] and anew.tasks[1].parameters != before[1].parameters
    assert len(anew.said) == 1


def test_what_moves_by_little_leaves_everything_as_it_is(
    withheld: CaptureSet, tasks: list[FabricTask], shelf: DrapeCache, monkeypatch: pytest.MonkeyPatch
) -> None:
    sigma = max(task.relative_sigma[ESTIMATED_NAMES.index("bending_weft")] for task in tasks)
    answers(1.0 + 0.5 * WORTH * sigma, monkeypatch)
    anew = estimated_anew(withheld, tasks, FOUND, shelf, CELL_M)
    assert anew.tasks == () and anew.said == ()


def test_what_cannot_be_simulated_is_said(
    withheld: CaptureSet, tasks: list[FabricTask], shelf: DrapeCache, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: object) -> IndirectEstimate:
        raise SimulationError("it tears", code="torn")

    monkeypatch.setattr(IndirectEstimator, "estimate", fails)
    anew = estimated_anew(withheld, tasks, FOUND, shelf, CELL_M)
    assert anew.tasks == ()
    assert anew.said == ("parameters could not be estimated again with air_draft in the simulations: it tears",)


class Rounds(NamedTuple):
    """A diagnosis, how many drapes were solved for it, and what was told on the way."""

    found: Diagnosis
    solved: int
    steps: list[tuple[float, str]]


@pytest.fixture(scope="module")
def second(withheld: CaptureSet) -> Rounds:
    """From nothing at hand; the second round answers, whether it says more or not."""
    keep, solved, steps = Simulator._keep, [], []

    def counted(simulator: Simulator, key: str, drape: Drape, began: float) -> KeyedDrape:
        solved.append(key)
        return keep(simulator, key, drape, began)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Simulator, "_keep", counted)
        patch.setattr(whole, "says_more", lambda *_: True)
        nothing = DrapeCache(None)
        found = diagnose(withheld, OPTIONS, cache=nothing, on_step=lambda done, what: steps.append((done, what)))
    return Rounds(found, len(solved), steps)


@pytest.fixture(scope="module")
def answered(second: Rounds) -> Diagnosis:
    return second.found


def test_the_second_round_has_what_was_estimated_again(second: Rounds, tasks: list[FabricTask]) -> None:
    found = second.found
    assert found.report.cause.top == "air_draft"
    assert sum("estimated again with air_draft" in text for text in found.assumed) == len(tasks)
    assert found.report.assumed == found.assumed
    assert all(r.task.parameters != t.parameters for r, t in zip(found.results, tasks, strict=True))
    assert found.report.cost.simulations == second.solved > 0
    assert [done for done, _ in second.steps] == sorted(done for done, _ in second.steps)
    assert (0.5, "parameters estimated again") in second.steps


@pytest.fixture
def put(tasks: list[FabricTask], monkeypatch: pytest.MonkeyPatch) -> Callable[..., CaptureSet]:
    """Stands for what a diagnosis goes through: its fabrics, what both rounds answer, what is estimated again."""

    def with_answer(answer: object, anew: Anew | None, own: Sequence[FabricTask] = tasks) -> CaptureSet:
        def again(*_: object) -> Anew:
            return anew if anew is not None else pytest.fail("there is no second round")

        monkeypatch.setattr(whole, "prepare_tasks", lambda *_: (list(own), []))
        monkeypatch.setattr(whole, "explain_fabric", lambda task, cache: SimpleNamespace(task=task))
        monkeypatch.setattr(whole, "with_poses_found", lambda _: None)
        monkeypatch.setattr(whole, "conclude", lambda *_, **__: answer)
        monkeypatch.setattr(whole, "estimated_anew", again)
        return cast(CaptureSet, None)

    return with_answer


@pytest.mark.parametrize("moved", [True, False])
def test_else_the_first_round_answers_and_all_of_it_is_counted(
    moved: bool,
    put: Callable[..., CaptureSet],
    answered: Diagnosis,
    tasks: list[FabricTask],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(whole, "says_more", lambda *_: False)
    anew = Anew(tuple(tasks) if moved else (), () if moved else ("it tears",), Cost(simulations=5, seconds=1.0))
    found = diagnose(put(answered, anew), OPTIONS, cache=DrapeCache(None))
    said = NO_MORE if moved else "it tears"
    assert found.assumed == found.report.assumed == (*answered.assumed, said)
    again = cost_of(answered.results, answered.looks, Cost()).simulations if moved else 0
    assert found.report.cost.simulations == answered.report.cost.simulations + 5 + again
    assert found.results == answered.results and found.report.cause == answered.report.cause


def test_magnets_that_held_otherwise_in_the_first_round_do_so_in_the_second(
    put: Callable[..., CaptureSet], answered: Diagnosis, tasks: list[FabricTask], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(whole, "says_more", lambda *_: True)
    first = replace(answered, pin_radius_m=0.0)
    assert diagnose(put(first, Anew(tuple(tasks))), OPTIONS, cache=DrapeCache(None)).pin_radius_m == 0.0


@pytest.mark.parametrize(
    ("estimated", "named", "count"), [(False, ("air_draft",), 2), (True, (), 2), (True, ("air_draft",), 1)]
)
def test_there_is_one_round_where_nothing_is_estimated_or_named_or_one_fabric_alone_is_seen(
    estimated: bool, named: tuple[str, ...], count: int, put: Callable[..., CaptureSet], tasks: list[FabricTask]
) -> None:
    own = [replace(task, estimated=estimated) for task in tasks[:count]]
    answer = SimpleNamespace(cause=SimpleNamespace(named=named))
    found: object = diagnose(put(answer, None, own), OPTIONS, cache=DrapeCache(None))
    assert found is answer


def test_a_second_round_is_forecast(tasks: list[FabricTask], make_set: MakeSet) -> None:
    assert "parameters are estimated again" in forecast(tasks, DrapeCache(None)).sentence()
    stated = prepare_tasks(make_set("air_draft=0.3"), ("air_draft",), CELL_M)[0]
    assert "estimated" not in forecast(stated, DrapeCache(None)).sentence()
    assert "estimated" not in forecast(tasks[:1], DrapeCache(None)).sentence()


@pytest.mark.parametrize(
    ("again", "first", "more"),
    [
        ({"after": 0.5}, {"after": 0.6}, True),
        ({"after": 0.6}, {"after": 0.5}, False),
        ({"after": 0.5, "unit": "standard deviations"}, {"after": 0.6}, False),
        (None, {"after": 0.6}, False),
        ({"after": 0.5}, None, False),
    ],
)
def test_the_second_round_answers_where_held_out_captures_come_nearer(
    again: Mapping[str, object] | None, first: Mapping[str, object] | None, more: bool, answered: Diagnosis
) -> None:
    def shrunk(update: Mapping[str, object] | None) -> GapReport:
        shrinkage = answered.report.shrinkage
        assert shrinkage is not None
        changed = None if update is None else shrinkage.model_copy(update=dict(update))
        return answered.report.model_copy(update={"shrinkage": changed})

    assert says_more(shrunk(again), shrunk(first)) is more


@pytest.mark.parametrize("names", [(), ("air_draft", "hem_weight"), ("panel_tilt",)])
def test_a_round_that_names_something_else_does_not_answer(names: tuple[str, ...], answered: Diagnosis) -> None:
    report = answered.report
    assert report.shrinkage is not None
    nearer = report.model_copy(update={"shrinkage": report.shrinkage.model_copy(update={"after": 0.0})})
    effects = tuple(report.cause.effects[0].model_copy(update={"name": name}) for name in names)
    other = nearer.model_copy(update={"cause": report.cause.model_copy(update={"effects": effects})})
    assert says_more(nearer, report) and not says_more(other, report)
