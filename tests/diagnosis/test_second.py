"""A second effect on the cloth, sought by simulating it beside the first at several sizes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from diagnosis.afresh import by_distance, second
from diagnosis.afresh.by_distance import known_squares, most, squares
from diagnosis.afresh.fresh import FreshLook, Sized, with_effects
from diagnosis.afresh.second import look_for_second
from diagnosis.effect import SCALAR
from diagnosis.effects import get_effect
from diagnosis.inference.cause import Cause
from diagnosis.inference.evidence import Evidence
from diagnosis.inference.larger import MUCH
from diagnosis.inference.pairs import Pair
from diagnosis.measurement.picture import picture_of
from diagnosis.scene import SimulationScene
from diagnosis.simulation.drape_cache import DrapeCache
from diagnosis.simulation.simulator import Simulator
from diagnosis.tasks.fabric_task import BASE_JITTER
from simcore.mesh import GridMesh
from simcore.parameters import FabricParameters
from simcore.scenes import Setup

DRAFT = {SCALAR: 0.45}
PLACES: Mapping[str, Mapping[str, float]] = {"crease": {"down": 1.0, "position": 0.5}}
SECONDS = ("panel_adhesion", "crease", "pin_drop", "hem_weight", "off_grain")
"""From the likeliest beside a draft to the least likely."""


def cause_of(*named: str, left: float | None = 20.0) -> Cause:
    """One effect or two for certain, and pairs of a draft with others, a scatter and a camera among them."""
    names = ("air_draft", *SECONDS, "bending_hysteresis", "camera_translation", "none", "unknown")
    nats = {name: 50.0 if name == "air_draft" else 1.0 for name in names}
    sizes = {name: DRAFT | dict(PLACES.get(name, {})) for name in names}
    evidence = {n: Evidence(n, nats[n], nats[n], {}, sizes[n], sizes[n], nats[n], {}) for n in names}
    seconds = ("bending_hysteresis", "camera_translation", *SECONDS)
    tried = tuple(
        Pair("air_draft", n, {"air_draft": DRAFT, n: sizes[n]}, Evidence(n, 40.0 - k, 0.0, {}, {}, {}, 0.0, {}))
        for k, n in enumerate(seconds)
    )
    probabilities = dict.fromkeys(names, 0.0) | {name: 1.0 / len(named) for name in named}
    pair = next((p for p in tried if len(named) == 2 and p.second == named[1]), None)
    return Cause(probabilities, evidence, 9.0, pair, float(pair is not None), tried=tried, left=left)


@pytest.fixture
def simulated(monkeypatch: pytest.MonkeyPatch) -> dict[str, list[float]]:
    """Sizes at which second effects were simulated; an adhesion of 3 Pa brings fabrics nearest, a crease a little."""
    asked: dict[str, list[float]] = {}

    def left(name: str, size: float) -> float:
        if name == "panel_adhesion":
            return 0.2 + abs(np.log(size / 3.0))
        return 0.8 if name == "crease" and size == 1.5 else 1.1

    def distances(looks: Any, trials: Sequence[Sequence[Sized]], scene: str, workers: Any) -> Any:
        assert scene == "stretch" and all(trial[0] == ("air_draft", DRAFT) for trial in trials)
        for _, (name, size) in trials:
            asked.setdefault(name, []).append(size[SCALAR])
            assert {k: v for k, v in size.items() if k != SCALAR} == PLACES.get(name, {})
        return np.array([[4.0 * left(trial[1][0], trial[1][1][SCALAR])] * 3 for trial in trials])

    monkeypatch.setattr(second, "known_squares", lambda looks, effects, scene, workers: np.full(3, 4.0))
    monkeypatch.setattr(second, "squares", distances)
    return asked


def looked(monkeypatch: pytest.MonkeyPatch, before: Cause, after: Cause) -> tuple[list[Pair], bool]:
    """Pairs that were simulated together, and whether what was learnt is kept."""
    together: list[Pair] = []
    first, other, copied = (SimpleNamespace(result=name) for name in ("before", "after", "copied"))
    first.copy = lambda: copied

    def with_pairs(looks: Any, pairs: Sequence[Pair], scene: str, workers: Any) -> Any:
        assert looks["f"] is copied  # what is only on trial teaches the fabric nothing
        together.extend(pairs)
        return {"f": other}

    monkeypatch.setattr(second, "with_pairs", with_pairs)
    monkeypatch.setattr(second, "look_together", lambda looks, name, scene, workers: looks)
    looks: Any = {"f": first}
    found = look_for_second(looks, lambda results: before if results == ["before"] else after, "stretch")  # type: ignore[comparison-overlap]
    return together, found["f"] is other  # type: ignore[comparison-overlap]


def test_the_size_at_which_captures_are_nearest_is_simulated_with_the_first(
    monkeypatch: pytest.MonkeyPatch, simulated: dict[str, list[float]]
) -> None:
    monkeypatch.setattr(second, "SECOND_EFFECTS", 3)
    together, kept = looked(monkeypatch, cause_of("air_draft"), cause_of("air_draft", "panel_adhesion"))
    (pair,) = together  # a crease brings fabrics nearer, but not much
    assert (pair.first, pair.second) == ("air_draft", "panel_adhesion") and kept
    own = get_effect("panel_adhesion").components[SCALAR]
    middle = (own.low * own.high) ** 0.5
    step = (own.high / own.low) ** 0.25
    assert simulated["panel_adhesion"] == pytest.approx([own.low, middle, own.high, middle / step, middle * step])
    assert pair.sizes["panel_adhesion"][SCALAR] == pytest.approx(middle * step)  # 3.06 Pa
    assert set(simulated) == set(SECONDS[: second.SECOND_EFFECTS])  # neither what scatters nor what moves no cloth
    assert len(simulated["crease"]) == 8 and len(simulated["pin_drop"]) in (3, 6)  # of both signs; no more, no nearer


@pytest.mark.parametrize(
    "before",
    [
        cause_of("air_draft", left=0.9 * MUCH),
        cause_of("air_draft", left=None),
        cause_of("none"),
        cause_of("unknown"),
        cause_of("camera_translation"),
    ],
)
def test_nothing_is_simulated_where_all_is_explained_or_the_cloth_is_not_what_is_named(
    monkeypatch: pytest.MonkeyPatch, simulated: dict[str, list[float]], before: Cause
) -> None:
    assert looked(monkeypatch, before, cause_of("air_draft", "panel_adhesion")) == ([], False)
    assert not simulated


@pytest.mark.parametrize("named", [("air_draft",), ("air_draft", "crease"), ("unknown",)])
def test_it_counts_only_where_the_second_effect_is_then_named(
    monkeypatch: pytest.MonkeyPatch, simulated: dict[str, list[float]], named: tuple[str, ...]
) -> None:
    together, kept = looked(monkeypatch, cause_of("air_draft"), cause_of(*named))
    assert len(together) == 1 and not kept


def test_most_fabrics_speak() -> None:
    before = np.array([4.0, 4.0, 4.0, np.inf])
    assert most(np.array([1.0, 2.0, 8.0, np.inf]), before) == 0.5  # a fabric without a capture says nothing
    assert most(np.array([1.0, 2.0, 3.0, 4.0]), np.full(4, 4.0)) == 0.75
    assert most(np.ones(1), np.full(1, np.inf)) == np.inf


def test_captures_are_nearest_at_the_size_that_they_were_made_with(tmp_path_factory: pytest.TempPathFactory) -> None:
    """A draft presses the cloth to a panel it sticks to: of three adhesions the true one leaves least."""
    simulator = Simulator(DrapeCache(tmp_path_factory.mktemp("drapes")))
    fabric, mesh = FabricParameters(1000.0, 800.0, 300.0, 1.5e-5, 1.5e-5, 1.5e-5, 0.2), GridMesh(0.02)
    scene = SimulationScene(Setup.nominal("stretch"))
    draft, true = ("air_draft", {SCALAR: 0.3}), ("panel_adhesion", {SCALAR: 2.0})
    base = simulator.put_up(mesh, fabric, scene, 0, BASE_JITTER)
    blown = simulator.proceed(base, fabric, with_effects(scene, [draft]))
    stuck = simulator.proceed(blown, fabric, with_effects(scene, [draft, true]))
    depth = picture_of(stuck.drape, with_effects(scene, [draft, true]))
    capture = SimpleNamespace(id="one", scene="stretch", base=base, depth=depth)
    task = SimpleNamespace(captures=[capture], parameters=fabric)

    class Look(FreshLook):
        def drape(self, capture: Any, effects: Sequence[Sized], fabric: Any = None) -> Any:
            return {(): base, ("air_draft",): blown, ("air_draft", "panel_adhesion"): stuck}[
                tuple(name for name, _ in effects)
            ]

        def seen(self, capture: Any, effects: Sequence[Sized] = ()) -> SimulationScene:
            return with_effects(scene, effects)

    result: Any = SimpleNamespace(task=task, captures=[capture])
    looks: dict[str, FreshLook] = {"f": Look(simulator, result)}
    trials = [[draft], *([draft, ("panel_adhesion", {SCALAR: size})] for size in (0.7, 2.0, 5.0))]
    alone, weak, right, strong = squares(looks, trials, "stretch")[:, 0]
    assert right < 0.01 * min(alone, weak, strong)
    assert known_squares(looks, [draft], "stretch")[0] == pytest.approx(alone)
    assert known_squares(looks, [draft, true], "stretch")[0] == pytest.approx(right)
    assert np.isinf(squares(looks, trials, "hanging")).all() and np.isinf(known_squares(looks, [], "hanging")).all()
    assert by_distance.most(np.array([right]), np.array([alone])) < 0.01
