"""What has not changed is not weighed again."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from diagnosis.afresh.once import once


def test_the_same_results_are_weighed_once_and_changed_ones_again() -> None:
    asked: list[int] = []

    def weigh(results: Any) -> Any:
        asked.append(len(results))
        return SimpleNamespace(number=len(asked))

    answer = once(weigh)
    results: list[Any] = [SimpleNamespace(), SimpleNamespace()]
    assert answer(results).number == answer(list(results)).number == 1
    assert answer([results[0], SimpleNamespace()]).number == 2
    assert answer(results).number == 1  # a trial that changes nothing goes back to it
    assert answer(results[:1]).number == 3
    assert answer(results).number == 4  # two are kept
    assert asked == [2, 2, 1, 2]
