"""Estimates of cases of a blind check, the effects in the simulations (`drapemeter estimate --simulator`), and without.

    python bench/bench_indirect.py CHECK case-001 case-002 ... [--off 0.15]

CHECK is a folder of `drapemeter blind make` whose labels may be opened. The stated parameters are not looked at; the
effects' sizes are given off by a factor drawn log-normally, as those that a diagnosis finds are off.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from results import add_json_option

from capture.capture_set import CaptureSet
from capture.prepare import prepare_all
from diagnosis.effect import SCALAR
from diagnosis.effects import get_effect
from diagnosis.extension import AppliedEffect, SimulatorExtension
from diagnosis.indirect_estimate import IndirectEstimator
from diagnosis.simulation.drape_cache import DrapeCache
from diagnosis.simulation.simulator import Simulator
from simcore.parameters import ESTIMATED_NAMES
from trainer.predict import Estimate, Estimator


@dataclass(frozen=True)
class Row:
    """One fabric of a case.

    Attributes:
        case, fabric: which.
        effects: as they were given.
        first, then: errors of ln p, [6], without and with the effects in the simulations.
        first_inside, then_inside: of the six, truths inside their 90 % intervals.
        simulations, unrested: of these, that did not come to rest.
        cpu_s: of the simulations.
    """

    case: str
    fabric: str
    effects: tuple[str, ...]
    first: list[float]
    then: list[float]
    first_inside: int
    then_inside: int
    simulations: int
    unrested: int
    cpu_s: float


def estimated(check: Path, case: str, off: float, network: Estimator, simulator: Simulator) -> Iterator[Row]:
    """A case's fabrics one by one."""
    label = json.loads((check / "labels" / f"{case}.json").read_text())
    rng = np.random.default_rng(int("".join(filter(str.isdigit, case))))
    effects = tuple(_off(effect, float(np.exp(rng.normal(0.0, off)))) for effect in label["effects"])
    captures = CaptureSet.load(check / case)
    indirect = IndirectEstimator(
        captures, prepare_all(captures.captures), SimulatorExtension(effects=effects), network, simulator
    )
    for fabric in sorted({capture.fabric.id for capture in captures.captures}):
        density, before = captures.fabrics[fabric].density, simulator.cost.seconds
        assert density is not None  # a blind check states it
        found = indirect.estimate(fabric, density)
        truth = label["parameters"][fabric]
        yield Row(
            case,
            fabric,
            tuple(effect.option for effect in effects),
            *(_errors(one, truth).tolist() for one in (found.first, found.estimate)),
            *(_inside(one, truth) for one in (found.first, found.estimate)),
            found.simulations,
            found.unrested,
            round(simulator.cost.seconds - before, 2),
        )


def _off(effect: dict[str, object], by: float) -> AppliedEffect:
    """An effect of a label, its size so many times as large."""
    known, size = get_effect(str(effect["name"])), effect["magnitude"]
    sizes = size if isinstance(size, dict) else {SCALAR: size}
    place = effect["place"]
    assert isinstance(place, dict)
    return AppliedEffect(name=known.name, size=known.size({**{k: by * v for k, v in sizes.items()}, **place}))


def _errors(found: Estimate, truth: dict[str, float]) -> NDArray[np.float64]:
    return np.log([found.parameters[name] / truth[name] for name in ESTIMATED_NAMES])


def _inside(found: Estimate, truth: dict[str, float]) -> int:
    return sum(found.intervals_90[name][0] <= truth[name] <= found.intervals_90[name][1] for name in ESTIMATED_NAMES)


def _say(name: str, rows: list[Row]) -> None:
    first, then = (np.array([getattr(row, which) for row in rows]) for which in ("first", "then"))
    inside = [sum(getattr(row, which) for row in rows) / first.size for which in ("first_inside", "then_inside")]
    print(
        f"| {name} | {len(rows)} | {np.sqrt(np.mean(first**2)):.2f} -> {np.sqrt(np.mean(then**2)):.2f} "
        f"| {np.median(np.abs(first)):.2f} -> {np.median(np.abs(then)):.2f} | {inside[0]:.0%} -> {inside[1]:.0%} "
        f"| {np.median([row.cpu_s for row in rows]):.0f} |",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("check", type=Path)
    parser.add_argument("cases", nargs="+")
    parser.add_argument("--off", type=float, default=0.15, help="standard deviation of ln of the sizes' factor")
    add_json_option(parser, "indirect")
    given = parser.parse_args()
    network, simulator = Estimator.load(), Simulator(DrapeCache(None))
    print("| effects | fabrics | rms error of ln p | median | truths in 90 % intervals | CPU s a fabric |")
    print("|---|---|---|---|---|---|")
    rows: list[Row] = []
    for case in given.cases:
        own = list(estimated(given.check, case, given.off, network, simulator))
        rows += own
        _say(f"{case}: {', '.join(own[0].effects) if own else ''}", own)
    _say("all", rows)
    given.json.write_text(json.dumps({"off": given.off, "rows": [asdict(row) for row in rows]}, indent=1) + "\n")


if __name__ == "__main__":
    main()
