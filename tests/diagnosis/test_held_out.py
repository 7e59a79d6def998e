"""What is held out against simulations afresh, some of which do not come to rest."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from diagnosis.effects import get_effect
from diagnosis.shrinkage.held_out import Judge, not_at_rest_with, whitened
from diagnosis.simulation.sizes import nodes
from tests.diagnosis.test_refutation import held

TURNED = ("focal_scale", nodes(get_effect("focal_scale"))[0])


class Look:
    """Of one capture, whose change by any effects is 7 mm everywhere."""

    result = SimpleNamespace(captures=[SimpleNamespace(id="a", base="the state without effects")])

    def __init__(self, count: int, *, at_rest: bool) -> None:
        self.shown = np.full(count, 0.007)
        self.found = SimpleNamespace(drape=SimpleNamespace(ok=at_rest))

    def drape(self, capture: Any, effects: Any) -> Any:
        return self.found

    def change(self, capture: Any, effects: Any) -> Any:
        return self.shown


@pytest.mark.parametrize("at_rest", [True, False])
def test_what_does_not_come_to_rest_counts_as_known_without_a_simulation(at_rest: bool) -> None:
    block = held("f1", 2.0, 0.5, camera=1.0).block
    look = Look(len(block.owner), at_rest=at_rest)
    looks: Any = {"f1": look}
    found = Judge(looks).response(block, [TURNED])
    known = block.metres(whitened(block, [TURNED]))
    assert np.abs(known - look.shown).max() > 1e-4
    np.testing.assert_array_equal(found, look.shown if at_rest else known)


def test_what_does_not_come_to_rest_and_has_no_response_counts_as_far_as_it_came() -> None:
    block = held("f1", 2.0, 0.5, camera=1.0).block
    block = replace(block, stated=replace(block.stated, responses={}))
    look = Look(len(block.owner), at_rest=False)
    looks: Any = {"f1": look}
    np.testing.assert_array_equal(Judge(looks).response(block, [TURNED]), look.shown)


@pytest.mark.parametrize("at_rest", [True, False])
def test_captures_for_which_no_fresh_simulation_stands_are_told_of(at_rest: bool) -> None:
    base = SimpleNamespace(drape=SimpleNamespace(ok=False))  # of that the report tells elsewhere
    captures = [SimpleNamespace(id=name, base=base) for name in ("a", "b")]
    drape = SimpleNamespace(drape=SimpleNamespace(ok=at_rest))
    looks: Any = {"f1": SimpleNamespace(result=SimpleNamespace(captures=captures), drape=lambda *_: drape)}
    lines = not_at_rest_with([held("f1", 2.0, 0.5, camera=1.0)], looks)
    assert lines == [] if at_rest else len(lines) == 1 and lines[0].startswith("a: with what was found")
    looks["f1"].drape = lambda capture, _: capture.base
    assert not_at_rest_with([held("f1", 2.0, 0.5, camera=1.0)], looks) == []
