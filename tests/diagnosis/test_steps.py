"""What is told of how far a diagnosis is."""

from __future__ import annotations

from diagnosis.steps import FIRST_LOOK, UNTOLD, Steps


def test_looks_that_begin_once_more_do_not_go_back() -> None:
    told: list[tuple[float, str]] = []
    steps = Steps(lambda done, what: told.append((done, what)), fabrics=2)
    steps.begin()
    steps.fabric()
    steps.fabric()
    steps.look(4)
    steps.look(1)  # magnets hold the cloth otherwise
    steps.measure()
    assert told[:3] == [(0.0, "0 of 2 fabrics"), (FIRST_LOOK / 2, "1 of 2 fabrics"), (FIRST_LOOK, "2 of 2 fabrics")]
    assert told[4] == (told[3][0], "closer look 1 of 10") and FIRST_LOOK < told[3][0] < told[5][0] < 1.0


def test_nobody_needs_to_be_told() -> None:
    UNTOLD.begin()
    UNTOLD.measure()
