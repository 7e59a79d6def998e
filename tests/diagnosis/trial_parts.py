"""Fabrics and workers for looks on trial: nothing is simulated, what was asked for is kept."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from types import SimpleNamespace
from typing import Any

from diagnosis.afresh.fresh import Sized


def trial_look(result: Any = None, sizes: Mapping[str, Any] | None = None) -> Any:
    """In the place of a fabric's look; its copy, which may learn on trial, has the result ``copied``."""
    copied = SimpleNamespace(through=(), result="copied", sizes={})
    return SimpleNamespace(through=(), result=result, sizes=dict(sizes or {}), copy=lambda: copied)


class TrialWorkers:
    """In the place of workers.

    Args:
        shown: what the first fabric's look has become, each time; by default all looks stay as they are.
        untaught: a look that is never to be simulated: it would learn what is only on trial.

    Attributes:
        wanted: effects with their sizes that fabrics were to be simulated with, each time.
        through: the cameras through which, each time.
    """

    def __init__(self, shown: Callable[[], Any] | None = None, untaught: Any = None) -> None:
        self._shown, self._untaught = shown, untaught
        self.wanted: list[list[Sized]] = []
        self.through: list[tuple[Sized, ...]] = []

    @property
    def names(self) -> list[list[str]]:
        """Of what was wanted."""
        return [[name for name, _ in wanted] for wanted in self.wanted]

    def map(self, work: partial[Any], items: list[Any]) -> list[Any]:
        """As :meth:`diagnosis.workers.Workers.map` for :func:`diagnosis.afresh.side_by_side.side_by_side`."""
        assert all(item is not self._untaught for item in items)
        asked = work.keywords["work"].keywords
        self.wanted.append(list(asked["wanted"]))
        self.through.append(asked["through"])
        return [(item, item) for item in items] if self._shown is None else [(items[0], self._shown())]
