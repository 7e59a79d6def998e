"""A report that names one effect, or none, and says little else."""

from __future__ import annotations

from diagnosis.effects import catalogue
from diagnosis.report import CauseReport, CostReport, FoundEffect, Gap, GapReport, RegionGap


def report(top: str, p: float = 0.9, rows: tuple[RegionGap, ...] = (), alike: tuple[str, ...] = ()) -> GapReport:
    probabilities = dict.fromkeys((*catalogue(), "none", "unknown"), 0.0) | {"pin_spacing": 1.0 - p, top: p}
    named = () if top in ("none", "unknown") else (top,)
    effects = tuple(
        FoundEffect(name=n, stage=catalogue()[n].stage.value, magnitude=1.0, unit="", interval_90=(0.5, 2.0))
        for n in named
    )
    return GapReport(
        gap=Gap(detected=top != "none", p_value=0.5, value=1.0, noise_floor=0.5),
        where=rows,
        cause=CauseReport(probabilities=probabilities, top=top, effects=effects, not_separable_from=alike),
        shrinkage=None,
        parameters_refitted=True,
        cost=CostReport(simulations=1, seconds=1.0),
        model_version="x",
    )
