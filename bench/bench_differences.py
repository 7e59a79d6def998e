"""Small differences between simulators that are in nobody's catalogue: are they called by a wrong name?

    python bench/bench_differences.py [--effect panel_tilt=8] [--kinds points,reach] [--fabrics 4] [--json FILE]

Capture sets are simulated, in a process of their own, by a solver that differs in one way from the diagnosis's, which
knows nothing of it; each without and with a true effect, which has then to be named. Mesh and jitter always differ:

* ``points``: a magnet holds a point of the cloth, where the set states 10 mm;
* ``reach``: contact begins to push 3 mm before the panel instead of 1 mm;
* ``friction``: the panel holds the cloth with a coefficient of 0.2 (its effect is taken out of the catalogue);
* ``early``: stopped at a hundred times the residual, stable or not, as a simulator with damping may be.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from results import add_json_option

from capture.capture_set import CaptureSet
from diagnosis.diagnose import DiagnosisOptions, diagnose
from diagnosis.effects import parse_effect
from diagnosis.simulation.drape_cache import DrapeCache
from diagnosis.synthesis import SynthesisPlan, make_capture_set
from renderer.atomic import write_atomically

KINDS = ("points", "reach", "friction", "early")
REACH_M = 3e-3
TOLERANCE = 5e-2
"""Residual at which ``early`` stops [vertex weights]; the solver's own is 5e-4."""
FRICTION = "panel_friction=0.2"
PLAN = SynthesisPlan(fabrics=4, resolution_m=0.5 / 60, seed=77)
Row = dict[str, Any]


def make(kind: str, effect: str, folder: str, fabrics: int) -> None:
    """One capture set by the other solver; runs in a fresh process, whose kernels are not compiled yet."""
    if kind == "reach":
        _reach(REACH_M)
    if kind == "early":
        _stop_early()
    names = [text for text in (effect, FRICTION if kind == "friction" else "") if text]
    plan = replace(PLAN, fabrics=fabrics, pin_radius_m=0.0 if kind == "points" else PLAN.pin_radius_m)
    made = make_capture_set(Path(folder), plan, [parse_effect(text) for text in names], name=f"{kind} {effect}")
    path = made.folder / "captures.json"
    document = json.loads(path.read_text())
    document["setup"]["pin_radius_m"] = PLAN.pin_radius_m
    path.write_text(json.dumps(document))


def _reach(value: float) -> None:
    """All that read the barrier's reach; kernels take the value they find when they are compiled."""
    from simcore import contact, panel_kernels, solver

    for module in (panel_kernels, contact, solver):
        vars(module)["REACH_M"] = value


def _stop_early() -> None:
    from simcore import solver
    from simcore.newton import NewtonOptions

    def loose(**given: Any) -> NewtonOptions:
        return NewtonOptions(**{"tolerance": TOLERANCE, "certify": False, **given})

    vars(solver)["NewtonOptions"] = loose


def row(kind: str, effect: str, fabrics: int, cache: DrapeCache) -> Row:
    """Make a set and diagnose it."""
    with TemporaryDirectory() as folder:
        fresh = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(1, mp_context=fresh) as pool:
            pool.submit(make, kind, effect, folder, fabrics).result()
        began = time.process_time()
        without = ("panel_friction",) if kind == "friction" else ()
        report = diagnose(CaptureSet.load(Path(folder)), DiagnosisOptions(without=without), cache=cache).report
    likely = sorted(report.cause.probabilities.items(), key=lambda item: -item[1])[:3]
    return {
        "difference": kind,
        "effect": effect or "none",
        "gap_mm": round(report.gap.value, 2),
        "floor_mm": round(report.gap.noise_floor, 2),
        "p_value": round(report.gap.p_value, 3),
        "likely": {name: round(value, 2) for name, value in likely},
        "found": {e.name: e.magnitude for e in report.cause.effects},
        "cpu_s": round(time.process_time() - began, 1),
    }


def table(rows: list[Row]) -> str:
    """Markdown."""
    lines = ["| differs in | effect | gap, floor [mm] | p | probabilities | size |", "|---|---|---|---|---|---|"]
    for one in rows:
        likely = ", ".join(f"`{name}` {value:.2f}" for name, value in one["likely"].items())
        found = ", ".join(f"{name} {value}" for name, value in one["found"].items())
        gap = f"{one['gap_mm']:.2f}, {one['floor_mm']:.2f}"
        lines.append(f"| {one['difference']} | {one['effect']} | {gap} | {one['p_value']:.3f} | {likely} | {found} |")
    return "\n".join(lines)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--effect", default="panel_tilt=8")
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--fabrics", type=int, default=PLAN.fabrics)
    add_json_option(parser, "differences")
    given = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    rows = []
    with TemporaryDirectory() as shelf:
        for kind in given.kinds.split(","):
            for effect in ("", given.effect):
                rows.append(row(kind, effect, given.fabrics, DrapeCache(Path(shelf))))
                print(json.dumps(rows[-1]), flush=True)
                write_atomically(given.json, (json.dumps(rows, indent=1) + "\n").encode())
    print(table(rows))


if __name__ == "__main__":
    main()
