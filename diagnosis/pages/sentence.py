"""The finding in one plain sentence."""

from __future__ import annotations

from collections.abc import Sequence

from diagnosis.diagnose import Diagnosis
from diagnosis.effects import get_effect
from diagnosis.gap.detection import ALARM, WEIGHTS
from diagnosis.groups import group_of
from diagnosis.pages.advice import is_wide, not_tried
from diagnosis.report import GapReport, Shrinkage

TOLD = 0.05
"""A declared twin of what is named is told of from this probability on."""


def sentence(diagnosis: Diagnosis) -> str:
    """The finding in plain words."""
    report = diagnosis.report
    cause, detected = report.cause, report.gap.detected
    names = [effect.name for effect in cause.effects] or [cause.top]
    alike = sorted({twin for name in names for twin in group_of(name) if cause.probabilities.get(twin, 0.0) >= TOLD})
    top, p = " with ".join(names), sum(cause.probabilities[name] for name in dict.fromkeys([*names, *alike]))
    if len(names) == 2:  # of both, not of one or the other
        p = diagnosis.cause.both_probability
    twins = [twin for twin in alike if twin not in names]
    gap = _gap_text(report)
    if p < 0.5 and len(names) == 2:
        return (
            f"These captures do not tell what is missing ({gap}): {names[0]} is likeliest, alone or beside another "
            f"effect; that it is there with {names[1]} has probability {p:.2f} only."
        )
    if p < 0.5:
        either = " or ".join([top, *twins])
        return (
            f"These captures do not tell what is missing ({gap}): {either} is likeliest, with probability {p:.2f} only."
        )
    if top == "none" and detected:
        return f"They differ ({gap}), but no effect is probable enough to be named (no effect: probability {p:.2f})."
    if top == "none":
        why = "; what is stated of the fabrics may be as wrong, or folds may have fallen otherwise"
        why = why if is_wide(report) else ""
        return f"Simulation and captures agree as far as these captures can tell ({gap}{why}; probability {p:.2f})."
    differ = f"They differ ({gap})" if detected else f"That they differ at all is not certain ({gap})"
    if top == "unknown":
        tried = "effect that was tried" if not_tried(cause) else "effect of the catalogue"
        return f"{differ}, and no {tried} explains it (probability {p:.2f})."
    summary = " ".join(get_effect(name).summary for name in names)
    text = f"{differ}. Most probable cause: {top} (probability {p:.2f}). {summary}"
    if twins:
        text = (
            f"{differ}. Most probable cause: {top}, or in its place {' or '.join(twins)}, which these captures do not "
        )
        text += f"tell from it (together probability {p:.2f}). {summary}"
    if report.shrinkage is not None:
        text += _shrinks(report.shrinkage, names)
    if all(get_effect(name).random_repeats for name in names):
        text += " It makes repeats scatter and shifts none of them: no simulation comes nearer with it."
    return text


def _shrinks(found: Shrinkage, names: Sequence[str]) -> str:
    """What held-out captures say, with how often the others named the same; declared twins count as the same."""
    share, turns = 100 * found.fraction, found.named_without
    again = sum(all(group_of(name) & set(turn) for name in names) for turn in turns)
    beside = "both" if len(names) == 2 else "it"
    of = "the gap" if found.unit == "mm" else "what panel and pixels show"
    if turns and not again:
        text = f" Without the captures that are held out in turn, {beside} would not be named: how far {of} shrinks"
        return f"{text} with {beside} was not measured."
    if share >= 0.5:
        text = f" With {beside}, {share:.0f} % of {of} above the floor goes away on held-out captures"
    else:
        text = f" Yet with {beside}, {of} does not shrink on held-out captures"
    if again < len(turns):
        text += f"; without these, the others name {beside} in {again} of {len(turns)} turns"
    return f"{text}."


def _gap_text(report: GapReport) -> str:
    """The gap and its floor; of what panel and pixels show, where that is what was found to differ."""
    gap, found = report.gap, report.shrinkage
    against = "against a noise floor of" if gap.value > gap.noise_floor else "within the noise floor of"
    shape = f"{gap.value:.2f} mm {against} {gap.noise_floor:.2f} mm"
    if found is not None and found.unit != "mm":
        return (
            f"panel and pixels by {found.before:.1f} {found.unit} on held-out captures, where chance makes "
            f"{found.repeats or 1.0:.1f}; the cloth's shape by {shape}"
        )
    if not gap.detected or _alarms(gap.p_shape, "shape"):
        return shape
    if gap.p_pixels is not None and _alarms(gap.p_pixels, "pixels"):
        return f"panel and pixels, p = {gap.p_pixels:.1g}; the cloth's shape by {shape}"
    if gap.p_factor is not None and _alarms(gap.p_factor, "factor"):
        return f"in what all captures have in common, p = {gap.p_factor:.1g}; the cloth's shape by {shape}"
    return shape


def _alarms(p: float | None, test: str) -> bool:
    return p is not None and p < ALARM * WEIGHTS[test]
