"""One pin put elsewhere on trial against what is named."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from diagnosis.afresh import moved_pin
from diagnosis.afresh.fresh import FreshLook, with_effects
from diagnosis.afresh.moved_pin import (
    DIRECTIONS,
    LIKELIEST,
    SCREEN_M,
    SIZES_M,
    Move,
    may_be_a_pin,
    nearest,
    outdone_by_a_pin,
)
from diagnosis.effect import SCALAR
from diagnosis.effects import catalogue
from diagnosis.inference.cause import Cause
from diagnosis.inference.evidence import Evidence
from diagnosis.inference.larger import MUCH
from diagnosis.measurement.picture import picture_of
from diagnosis.scene import SimulationScene
from diagnosis.simulation.drape_cache import DrapeCache
from diagnosis.simulation.simulator import Simulator
from diagnosis.tasks.fabric_task import BASE_JITTER
from simcore.mesh import GridMesh
from simcore.parameters import FabricParameters
from simcore.scenes import Setup

STRETCH = SimulationScene(Setup.nominal("stretch"))
ALL = tuple(catalogue())
WITHOUT_PULL = tuple(name for name in ALL if name != "corner_pull")
IN = math.sqrt(0.5)
"""Of a pull less along the diagonal of the bottom right corner, along either axis."""


def cause_of(*named: str, left: float | None = 0.5) -> Cause:
    names = {*named, "none", "unknown"}
    evidence = {n: Evidence(n, 0.0, 0.0, {}, {SCALAR: 0.01}, {}, 0.0, {}) for n in names}
    probabilities = dict.fromkeys(names, 0.0) | {named[0] if named else "none": 1.0}
    return Cause(probabilities, evidence, 9.0, alone=probabilities, left=left)


@pytest.mark.parametrize(
    ("cause", "asked"),
    [
        (cause_of("pin_drop"), True),
        (cause_of("focal_scale"), True),
        (cause_of("hem_weight"), False),
        (cause_of("hem_weight", left=None), False),
        (cause_of("hem_weight", left=1.1 * MUCH), True),
        (cause_of("bending_hysteresis", left=1.1 * MUCH), False),
        (cause_of(left=1.1 * MUCH), False),
        (cause_of("sensor_smoothing", left=1.1 * MUCH), False),  # which no moved pin can be taken for
        (cause_of("depth_bias", left=1.1 * MUCH), True),
    ],
)
def test_it_is_looked_into_where_pins_may_be_taken_for_what_is_named(cause: Cause, asked: bool) -> None:
    assert may_be_a_pin(cause) is asked


def a_look(scene: str) -> Any:
    """Of a fabric with one capture."""
    return SimpleNamespace(
        result=SimpleNamespace(captures=[SimpleNamespace(scene=scene)]), scene_of=lambda capture: STRETCH
    )


def judged(
    monkeypatch: pytest.MonkeyPatch, left: Mapping[Move, float], effects: Sequence[str], cause: Cause | None = None
) -> tuple[bool, list[tuple[int, list[Move]]]]:
    """Whether a pin does better, and which moves of how many fabrics were simulated; ``left`` at the nearest move."""
    asked: list[tuple[int, list[Move]]] = []

    def squares(looks: Any, starts: Sequence[Any], scene: str, workers: Any) -> Any:
        moves = [start.keywords["move"] for start in starts]
        asked.append((len(looks), moves))

        def one(move: Move) -> float:
            own = [(math.dist(move[1:], to[1:]), value) for to, value in left.items() if to.pin == move.pin]
            return min((value + 100.0 * far for far, value in own), default=2.0)

        return np.array([[4.0 * one(move)] * len(looks) for move in moves])

    monkeypatch.setattr(moved_pin, "squares_from", squares)
    monkeypatch.setattr(moved_pin, "known_squares", lambda looks, effects, scene, workers: np.full(len(looks), 4.0))
    looks: Any = {"f0": a_look("hanging"), **{f"f{n}": a_look("stretch") for n in range(1, 5)}}
    return outdone_by_a_pin(looks, cause or cause_of("pin_drop"), effects, "stretch"), asked


def test_a_corner_pulled_less_does_better_than_what_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    true = Move("bottom_right", -0.008 * IN, 0.008 * IN)
    found, ((few, screened), (all_of_them, trials), *_) = judged(monkeypatch, {true: 0.5}, WITHOUT_PULL)
    assert found and (few, all_of_them) == (moved_pin.SCREENED, 4)
    assert len(screened) == len(STRETCH.setup.pins_m) * DIRECTIONS and len(trials) == LIKELIEST * len(SIZES_M)
    assert all(math.hypot(*move[1:]) == pytest.approx(SCREEN_M) for move in screened)
    assert any(math.dist(move[1:], true[1:]) < 1e-9 for move in trials)


@pytest.mark.parametrize(
    ("move", "effects"),
    [
        (Move("bottom_right", -0.008 * IN, 0.008 * IN), ALL),  # a pull along the diagonal
        (Move("top_left", 0.0, -0.006), ALL),  # a lowered pin
        (Move("top_left", -0.006, 0.0), ALL),  # one of two that are too far apart
    ],
)
def test_what_an_effect_does_to_a_pin_is_nothing_unknown(
    monkeypatch: pytest.MonkeyPatch, move: Move, effects: Sequence[str]
) -> None:
    assert not judged(monkeypatch, {move: 0.5}, effects)[0]


def test_a_move_is_made_longer_while_that_brings_captures_nearer(monkeypatch: pytest.MonkeyPatch) -> None:
    """A pin 10 mm off: 8 mm leave as much as what is named, 10 mm do not."""
    found, (_, _, *longer) = judged(monkeypatch, {Move("top_left", 0.0, 0.010): 0.8}, WITHOUT_PULL)
    assert found
    assert [math.hypot(*move[1:]) for _, (move,) in longer] == pytest.approx([0.010, 0.012])
    assert all(fabrics == 4 for fabrics, _ in longer)


@pytest.mark.parametrize(
    ("true", "asked"),
    [
        (0.003, []),
        (0.0053, [0.0053]),
        (0.006, []),
        (0.0066, [0.0066]),
        (0.010, [0.010, 0.012]),
        (0.020, [0.010, 0.012]),
    ],
)
def test_the_length_of_a_move_that_leaves_least_is_simulated(true: float, asked: list[float]) -> None:
    found: list[float] = []

    def share(size: float) -> float:
        return 0.5 + 1e5 * (size - true) ** 2

    def share_at(size: float) -> float:
        found.append(size)
        return share(size)

    least = nearest({size: share(size) for size in SIZES_M}, share_at)
    assert found == pytest.approx(asked)
    assert least == min(share(size) for size in (*SIZES_M, *found))


def test_lengths_that_all_leave_the_same_need_no_other() -> None:
    assert nearest(dict.fromkeys(SIZES_M, 0.7), lambda size: pytest.fail(f"simulated {size}")) == 0.7


def test_a_pin_that_does_little_better_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    assert not judged(monkeypatch, {Move("top_left", 0.0, 0.006): 0.95}, ALL)[0]
    assert judged(monkeypatch, {Move("top_left", 0.0, 0.006): 0.85}, ALL)[0]


def test_nothing_is_simulated_where_nothing_of_the_kind_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    assert judged(monkeypatch, {Move("top_left", 0.0, 0.006): 0.1}, ALL, cause_of("hem_weight")) == (False, [])


def test_in_hanging_no_pin_is_moved(monkeypatch: pytest.MonkeyPatch) -> None:
    """Folds fall elsewhere there, whatever moves."""
    monkeypatch.setattr(moved_pin, "known_squares", lambda *_: pytest.fail("simulated"))
    assert not outdone_by_a_pin({}, cause_of("pin_drop"), WITHOUT_PULL, "hanging")


def test_what_is_outdone_leaves_something_unknown() -> None:
    cause = cause_of("pin_drop")
    found = cause.outdone()
    assert found.top == "unknown" and found.named == () and sum(found.probabilities.values()) == pytest.approx(1.0)
    assert found.probabilities["pin_drop"] == pytest.approx(0.1)


def test_a_corner_pulled_less_is_found_by_simulation(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Beside a lowered pin that is not there; where the pull is in the catalogue, nothing unknown is found."""
    simulator = Simulator(DrapeCache(tmp_path_factory.mktemp("drapes")))
    fabric, mesh = FabricParameters(1000.0, 800.0, 300.0, 1.5e-5, 1.5e-5, 1.5e-5, 0.2), GridMesh(0.025)
    base = simulator.put_up(mesh, fabric, STRETCH, 0, BASE_JITTER)
    true = with_effects(STRETCH, [("corner_pull", {SCALAR: -0.008})])
    depth = picture_of(simulator.proceed(base, fabric, true).drape, true)
    capture = SimpleNamespace(id="one", scene="stretch", base=base, depth=depth, rms_m=0.01)
    task = SimpleNamespace(captures=[SimpleNamespace(id="one", depth=depth, scene=STRETCH)], parameters=fabric)
    result: Any = SimpleNamespace(task=task, captures=[capture])
    looks = {name: FreshLook(simulator, result) for name in ("f", "g")}
    cause = cause_of("pin_drop")
    assert outdone_by_a_pin(looks, cause, WITHOUT_PULL, "stretch")
    assert not outdone_by_a_pin({"f": looks["f"]}, cause, WITHOUT_PULL, "stretch")
    assert not outdone_by_a_pin(looks, cause, ALL, "stretch")
