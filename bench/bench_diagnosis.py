"""What a diagnosis costs: simulations and seconds, without and with an atlas, with one and two workers.

    python bench/bench_diagnosis.py [--fabrics 2] [--scenes stretch] [--repeats 2] [--workers 1,2] [--page PAGE]

Makes a capture set by simulation, then diagnoses it: nothing at hand; everything that does not depend on the captures
at hand (an atlas); everything at hand (the same set once more). Prints a table; ``--page`` replaces the page's section.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import shutil
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from results import add_json_option

from capture.capture_set import CaptureSet
from diagnosis.atlas import build_atlas
from diagnosis.atlas_part import atlas_parts
from diagnosis.diagnose import DiagnosisOptions, diagnose
from diagnosis.effects import catalogue, parse_effect
from diagnosis.simulation.drape_cache import DrapeCache
from diagnosis.synthesis import SynthesisPlan, make_capture_set
from renderer.atomic import write_atomically

TITLE = "## Diagnosis"
Row = dict[str, Any]


def measure(plan: SynthesisPlan, resolution_m: float, workers: list[int]) -> list[Row]:
    """All rows of the table."""
    rows = []
    with TemporaryDirectory() as name:
        folder = Path(name)
        captures = make_capture_set(folder / "set", plan, [parse_effect("pin_spacing=0.006")])
        atlas = DrapeCache(folder / "atlas")
        began = time.monotonic()
        effects = DiagnosisOptions(resolution_m=resolution_m).chosen()
        cost = build_atlas(atlas_parts(captures, effects, resolution_m), atlas)
        rows.append(_row("building the atlas", 1, cost.simulations, cost.seconds, began))
        for count in workers:
            for what, start in (("nothing at hand", None), ("atlas at hand", atlas)):
                cache = DrapeCache(folder / f"{what}-{count}")
                if start is not None:
                    shutil.copytree(folder / "atlas", folder / f"{what}-{count}")
                rows.append(_diagnose(what, captures, count, resolution_m, cache))
            rows.append(_diagnose("all at hand", captures, count, resolution_m, cache))
    return rows


def _diagnose(what: str, captures: CaptureSet, workers: int, resolution_m: float, cache: DrapeCache) -> Row:
    began = time.monotonic()
    found = diagnose(captures, DiagnosisOptions(resolution_m=resolution_m, workers=workers), cache=cache)
    cost = found.report.cost
    return _row(what, workers, cost.simulations, cost.solver_seconds, began)


def _row(what: str, workers: int, simulations: int, solver: float, began: float) -> Row:
    seconds = round(time.monotonic() - began, 1)
    return {
        "what": what,
        "workers": workers,
        "simulations": simulations,
        "solver_s": round(solver, 1),
        "seconds": seconds,
    }


def section(rows: list[Row], plan: SynthesisPlan, resolution_m: float) -> str:
    """Markdown."""
    lines = [
        TITLE,
        "",
        f"`python bench/bench_diagnosis.py`: {plan.fabrics} fabrics x {' and '.join(plan.scenes)} x {plan.repeats} "
        f"repeats, {len(catalogue())} effects, {1e3 * resolution_m:g} mm mesh, {platform.machine()}, {os.cpu_count()} "
        f"cores, load {os.getloadavg()[0]:.1f} at the end.",
        "",
        "| at hand before | workers | simulations | solver, CPU s | wall s |",
        "|---|---|---|---|---|",
        *(f"| {r['what']} | {r['workers']} | {r['simulations']} | {r['solver_s']} | {r['seconds']} |" for r in rows),
        "",
    ]
    return "\n".join(lines)


def put_section(page: Path, text: str) -> None:
    """Replace the page's own section, or add it."""
    old = page.read_text(encoding="utf-8") if page.exists() else "# Benchmarks\n\n"
    before, found, after = old.partition(TITLE + "\n")
    rest = after[after.index("\n## ") + 1 :] if found and "\n## " in after else ""
    write_atomically(page, (before.rstrip("\n") + "\n\n" + text + ("\n" + rest if rest else "")).encode())


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fabrics", type=int, default=2)
    parser.add_argument("--scenes", default="stretch")
    parser.add_argument("--repeats", type=int, default=2)
    parser.add_argument("--resolution", type=float, default=0.01)
    parser.add_argument("--workers", default="1,2")
    parser.add_argument("--page", type=Path)
    add_json_option(parser, "diagnosis")
    given = parser.parse_args()
    scenes = tuple(given.scenes.split(","))
    plan = SynthesisPlan(given.fabrics, scenes, given.repeats, resolution_m=0.5 / 60, seed=5)
    rows = measure(plan, given.resolution, [int(n) for n in given.workers.split(",")])
    text = section(rows, plan, given.resolution)
    print(text)
    if given.page is not None:
        put_section(given.page, text)
    write_atomically(given.json, (json.dumps(rows, indent=1) + "\n").encode())


if __name__ == "__main__":
    main()
