"""What captures that had no part in finding effects say against them."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from diagnosis.afresh.fresh import is_mechanical
from diagnosis.effects import get_effect
from diagnosis.groups import group_of
from diagnosis.inference.cause import Cause, is_on_pixels
from diagnosis.report import Shrinkage
from diagnosis.shrinkage.held_out import Measured, refit, whitened
from diagnosis.shrinkage.shares import fraction_of

Array = NDArray[np.float64]
WORSE = -0.25
"""An effect that closes less than this share of the gap is none of it: of six in 300 sealed cases five were wrong."""
PLAINLY = 1.02
"""What is left grows by this factor at least where an effect is refuted: near the scatter of repeats a share of what is
above it says nothing."""
LITTLE = ((0.1, 0.52), (0.5, 0.75))
"""An effect on the cloth that closes less than the first of the gap is named with at most the second's probability. Of
199 that were named in sealed cases and were there 10 closed less than a tenth and 25 less than 0.4; of 21 that were not
there 13 and 18 (decision 027). Of later ones 188 were there, eight below 0.1 and 16 from there to 0.5, and 16 were not,
six and six (decision 035)."""
NEEDED = 0.9
"""A second effect leaves less than this share of what the first alone leaves, or it is not needed."""
HARDLY_MORE = 1.25
"""What one effect leaves, over the scatter of repeats, below which a second one on the cloth is doubted twice (decision
039)."""
ESTIMATED_PAIR = 0.4
"""Most probability of two effects where parameters are estimated from the very captures, and held-out ones come no
nearer with two (decision 048)."""
SHOWN = 0.15
"""A second effect on the cloth beside one on camera or sensor closes more than this share of the gap that the first
leaves, the fabric that speaks most for it left out: 0.09 of one that was not there, 0.95 and more of four true ones."""


class Measure(Protocol):
    """How far the gap shrinks with what is named.

    ``known``: names are not sought again without what is held out; ``without``: nor are these, which were refuted.
    """

    def __call__(self, of: Cause, *, known: bool = False, without: Collection[str] = ()) -> Measured | None: ...


def judged(cause: Cause, measure: Measure, *, estimated: bool = False) -> tuple[Cause, Measured | None]:
    """What held-out captures leave of a cause, with the shrinkage by what is then named.

    Effects that take simulations away from captures are refuted; of two together, one may stay. One on the cloth that
    brings them little nearer is doubted. A second effect on the cloth with which the simulations come hardly nearer
    than with the first alone is refuted too, beside one on camera or sensor where one fabric alone shows it.

    Args:
        cause: as weighed.
        measure: how far the gap shrinks.
        estimated: parameters of half of the fabrics or more are estimated from these captures: a second effect may
            stand for what the first one made of them, unless it shows in pixels alone, brings held-out captures nearer,
            or neither of the two explains them alone.
    """
    measured = measure(cause)
    if measured is not None and len(cause.named) == 2:
        if is_refuted(measured):
            cause = cause.refuted()
            measured = measure(cause)
        elif times := _times_doubted(cause, measured, measure):
            doubted = cause.second_doubted(times)
            measured = measured if doubted.named == cause.named else measure(doubted)
            cause = doubted
    if estimated and len(cause.named) == 2 and cause.pair is not None and not is_on_pixels(cause.pair.second):
        single = cause.pairs_at_most(ESTIMATED_PAIR)
        if set(single.named) & set(cause.named) and not _nearer(measured, alone := measure(single)):
            cause, measured = single, alone
    refuted: set[str] = set()
    while measured is not None and is_refuted(measured):  # ends: none and unknown get what effects lose
        refuted.add(cause.top)
        cause = cause.refuted()
        measured = measure(cause, without=refuted - set(cause.named)) if cause.named else None
    if measured is not None and measured.shrinkage.simulated_afresh and _names_one_on_the_cloth(cause):
        for closed, most in LITTLE:
            if measured.shrinkage.fraction < closed:
                cause = cause.doubted(most)
    return (replace(cause, refuted_before=frozenset(refuted - set(cause.named))) if refuted else cause), measured


def _times_doubted(cause: Cause, measured: Measured, measure: Measure) -> int:
    """How often held-out captures speak against the second of two named effects."""
    if is_unshown(cause, measured):
        return 1
    single = cause.refuted()
    if not set(single.named) & set(cause.named) or not all(is_mechanical(get_effect(n)) for n in cause.named):
        return 0
    both, alone = measure(cause, known=True), measure(single, known=True)
    if both is None or alone is None:
        return 0
    return times_needless(both.shrinkage, alone.shrinkage, repeated=any(held.repeated for held in alone.held))


def _nearer(both: Measured | None, alone: Measured | None) -> bool:
    """Held-out captures come nearer with two effects than with one, names sought again without them both times."""
    if both is None or alone is None or both.shrinkage.unit != alone.shrinkage.unit:
        return False
    return both.shrinkage.after < NEEDED * alone.shrinkage.after


def _names_one_on_the_cloth(cause: Cause) -> bool:
    """One effect on the cloth is named, of the same form in all repeats."""
    return len(cause.named) == 1 and is_mechanical(get_effect(cause.top)) and not get_effect(cause.top).random_repeats


def is_refuted(measured: Measured) -> bool:
    """Simulated afresh on fabrics that had no part in finding it, the effect plainly takes the simulation away.

    Of three fabrics or more the one that speaks most against it does not decide alone: its folds may have been missed
    with the effect on.
    """
    found = measured.shrinkage
    if not found.simulated_afresh or found.fraction >= WORSE or found.after < PLAINLY * found.before:
        return False
    fabrics = _against(measured)
    if len(fabrics) < 3:
        return True
    return fraction_of(_others(measured, max(fabrics, key=lambda fabric: fabrics[fabric]))) <= 0.0


def is_unshown(cause: Cause, measured: Measured) -> bool:
    """Of two named effects the second is on the cloth, the first moves none, and no two held-out fabrics show it.

    Beside a strong effect on the picture a second one is had for little, and what another simulator does otherwise in
    one fabric is no effect. A fabric without which another second effect is named, or none, does not show this one. Of
    fewer than three fabrics all are heard.
    """
    if cause.pair is None or is_mechanical(get_effect(cause.pair.first)) or get_effect(cause.pair.first).random_repeats:
        return False
    if not is_mechanical(get_effect(cause.pair.second)) or not measured.shrinkage.simulated_afresh or not measured.held:
        return False
    beyond = _beyond_still(measured, cause.pair.second)
    fabrics = _against(beyond)
    least = min(fabrics, key=lambda fabric: fabrics[fabric]) if len(fabrics) > 2 else None
    return fraction_of(_others(beyond, least)) < SHOWN


def _beyond_still(measured: Measured, second: str) -> Measured:
    """What is held out against simulations that already have what moves no cloth; as far as the second is named, too.

    All of it: without what is held out, another effect on the camera may be named.
    """
    held = []
    for one in measured.held:
        still = [(name, size) for name, size in one.effects if not get_effect(name).moves_cloth]
        alone = refit(one.block, one.block.metres(whitened(one.block, still)))
        squares = one.squares.copy()
        squares[-1, 0] = float(np.mean(alone.left**2))
        if not group_of(second) & {name for name, _ in one.effects}:
            squares[-1, 1] = squares[-1, 0]
        held.append(replace(one, squares=squares))
    return replace(measured, held=tuple(held))


def _against(measured: Measured) -> dict[str, float]:
    """Of each fabric, how much farther the simulations are with what was found than without, in squares [m²]."""
    found: dict[str, float] = {}
    for held in measured.held:
        before, after = held.squares[-1][:2]
        found[held.block.fabric] = found.get(held.block.fabric, 0.0) + float(after - before)
    return found


def _others(measured: Measured, fabric: str | None) -> Array:
    """Squares of all blocks but a fabric's (None: of all) [m²], [blocks, 4]."""
    return np.stack([held.squares[-1] for held in measured.held if held.block.fabric != fabric])


def times_needless(together: Shrinkage, alone: Shrinkage, *, repeated: bool = True) -> int:
    """How often simulations afresh, held against captures that were held out, say that one effect does as well as two.

    Once where both leave about as much as one; twice where one leaves hardly more than repeats scatter, whatever both
    leave: what repeats do by chance needs no cause. Where nothing was ``repeated`` that is not known.
    """
    if not (together.simulated_afresh and alone.simulated_afresh):
        return 0
    if repeated and alone.repeats is not None and alone.after <= HARDLY_MORE * alone.repeats:
        return 2
    return 1 if together.after > NEEDED * alone.after else 0
