"""Fabrics looked at in other processes: what they learn there is known here, as if they had been looked at here."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TypeVar

from diagnosis.afresh.fresh import FreshLook
from diagnosis.workers import Workers

Made = TypeVar("Made")

LEARNT = ("found", "begun", "sizes", "coarse", "beside", "together")
"""What looks made from one another know together."""


def side_by_side(work: Callable[[FreshLook], Made], looks: Sequence[FreshLook], workers: Workers) -> list[Made]:
    """What ``work`` makes of every fabric, in their order.

    Where another process did it, the fabrics given learn what their copies there did, and their account of what was
    solved is added to; a look that was made from one shares both with it, as in this process.

    Args:
        work: a function that can be pickled, as can what it makes.
        looks: by one of each fabric.
        workers: that simulate fabrics side by side.
    """
    made = []
    for look, (copy, result) in zip(looks, workers.map(partial(_and_itself, work=work), looks), strict=True):
        if copy is not look:
            _learn(look, copy, result)
        made.append(result)
    return made


def _and_itself(look: FreshLook, work: Callable[[FreshLook], Made]) -> tuple[FreshLook, Made]:
    result = work(look)
    return look, result


def _learn(look: FreshLook, copy: FreshLook, result: object) -> None:
    """Take over what a copy from another process knows, for everything that shares it here."""
    for name in LEARNT:
        here, there = getattr(look, name), getattr(copy, name)
        here.clear()
        here.update(there)
        if isinstance(result, FreshLook) and getattr(result, name) is there:
            setattr(result, name, here)
    vars(look.simulator.cost).update(vars(copy.simulator.cost))
    if isinstance(result, FreshLook) and result.simulator is copy.simulator:
        result.simulator = look.simulator
