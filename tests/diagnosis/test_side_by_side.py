"""Fabrics looked at elsewhere leave behind what they would have left here."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import pytest

from diagnosis.afresh.fresh import FreshLook
from diagnosis.afresh.side_by_side import LEARNT, side_by_side
from diagnosis.simulation.drape_cache import DrapeCache
from diagnosis.simulation.simulator import Cost, Simulator
from diagnosis.workers import Workers


def fresh(name: str) -> FreshLook:
    result: Any = name
    look = FreshLook(Simulator(DrapeCache(None), Cost(3, 1, 2.0)), result)
    look.sizes["panel_tilt"] = [{"deg": 2.0}]
    return look


def learn(look: FreshLook, degrees: float) -> FreshLook:
    """Learns in passing, and makes another look that shares what is known."""
    look.sizes["panel_tilt"].append({"deg": degrees})
    look.begun["a", "panel_tilt"] = None  # type: ignore[assignment]  # no drape is needed here
    look.simulator.cost.add(Cost(5, 0, 1.0))
    made: Any = f"{look.result} seen"
    return replace(look, result=made)


def only_learn(look: FreshLook, degrees: float) -> float:
    return float(len(learn(look, degrees).sizes["panel_tilt"]))


@pytest.mark.parametrize("count", [1, 2])
def test_what_is_learnt_elsewhere_is_known_here(count: int) -> None:
    looks = [fresh("f1"), fresh("f2")]
    with Workers(count) as workers:
        made = side_by_side(partial(learn, degrees=4.0), looks, workers)
        numbers = side_by_side(partial(only_learn, degrees=6.0), made, workers)
    assert [one.result for one in made] == ["f1 seen", "f2 seen"]
    assert [one.result for one in looks] == ["f1", "f2"]
    assert numbers == [3.0, 3.0]
    for look, one in zip(looks, made, strict=True):
        assert look.sizes == one.sizes == {"panel_tilt": [{"deg": 2.0}, {"deg": 4.0}, {"deg": 6.0}]}
        assert look.begun.keys() == {("a", "panel_tilt")}
        assert look.simulator.cost == one.simulator.cost == Cost(13, 1, 4.0)
        assert all(getattr(look, name) is getattr(one, name) for name in LEARNT)


def test_everything_that_a_look_knows_is_taken_over() -> None:
    look = fresh("f1")
    shared = {name for name, value in vars(look).items() if isinstance(value, dict)}
    assert shared == set(LEARNT)


def test_simulations_that_ran_out_of_time_are_told() -> None:
    assert Cost(simulations=9).cut_short() == []
    (line,) = Cost(simulations=9, out_of_time=2).cut_short()
    assert "2 of 9 simulations" in line and "--resolution" in line
