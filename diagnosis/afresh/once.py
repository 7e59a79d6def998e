"""What was weighed is not weighed again while nothing has changed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import is_

from diagnosis.inference.cause import Cause
from diagnosis.tasks.fabric_task import FabricResult

Name = Callable[[Sequence[FabricResult]], Cause]
"""The answer from results: probabilities, two effects together included."""


KEPT = 2
"""Answers: a trial that changes nothing goes back to the one before."""


def once(name: Name) -> Name:
    """The same answers; where all results are those of one of the last calls (the same objects), its answer."""
    before: list[tuple[tuple[FabricResult, ...], Cause]] = []

    def answer(results: Sequence[FabricResult]) -> Cause:
        for known, cause in before:
            if len(known) == len(results) and all(map(is_, known, results)):
                return cause
        found = name(results)
        before[:] = [*before, (tuple(results), found)][-KEPT:]
        return found

    return answer
