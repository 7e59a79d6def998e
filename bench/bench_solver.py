"""CPU seconds per drape on one core: four fabrics, the prior, and MuJoCo's flex on the same scenes in the same run.

    python bench/bench_solver.py [--cells 10 5] [--seeds 2] [--prior 11] [--peer medium] [--json solver.json]

A drape is timed from the flat sheet to the certified rest, contact on; compilation is not in it and printed apart. The
peer needs the extra ``bench`` (``pip install -e .[bench]``) and is left out, with a line that says so, where it is not
installed. Ratios of one run are what to compare; seconds depend on the machine and its load.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import platform
import resource
import time
from typing import Any

import numpy as np
from fabrics import FABRICS
from results import add_json_option

from simcore.mesh import GridMesh
from simcore.parameters import FabricParameters
from simcore.prior import FabricPrior
from simcore.scenes import Scene, Setup
from simcore.solver import Solver

LIMIT_S = 300.0


def timed(solver: Solver, fabric: FabricParameters, scene: Scene, seeds: int) -> dict[str, Any]:
    """Mean over seeds."""
    drapes = [solver.solve(fabric, Setup.nominal(scene), seed=s, time_limit_s=LIMIT_S) for s in range(seeds)]
    return {
        "seconds": round(float(np.mean([d.seconds for d in drapes])), 2),
        "still": sum(d.ok for d in drapes),
        "of": seeds,
        "residual": float(max(d.residual for d in drapes)),
    }


def prior(solver: Solver, scene: Scene, count: int) -> dict[str, Any]:
    """Median and 90th percentile over fabrics drawn from the prior."""
    drawn = FabricPrior.default().sample_array(range(count), seed=11)
    drapes = [
        solver.solve(FabricParameters(*map(float, values)), Setup.nominal(scene), seed=n, time_limit_s=LIMIT_S)
        for n, values in enumerate(drawn)
    ]
    seconds = [d.seconds for d in drapes]
    return {
        "median_seconds": round(float(np.median(seconds)), 2),
        "p90_seconds": round(float(np.quantile(seconds, 0.9)), 2),
        "still": sum(d.ok for d in drapes),
        "of": count,
    }


def peer(name: str, scene: Scene, mesh: GridMesh) -> dict[str, Any]:
    """MuJoCo on the same scene."""
    from mujoco_peer import drape

    done = drape(FABRICS[name], Setup.nominal(scene), mesh, time_limit_s=LIMIT_S)
    return {
        "seconds": round(done.seconds, 2),
        "set_up_seconds": round(done.set_up_seconds, 2),
        "at_rest": done.at_rest,
        "speed_m_s": done.speed_m_s,
    }


def compiled(mesh: GridMesh) -> dict[str, float]:
    """Seconds of this process's first drape beyond its second: start of Taichi and compilation, or their cache."""
    began = time.perf_counter()
    solver = Solver(mesh)
    setup = Setup.nominal(Scene.HANGING)
    for _ in range(2):
        first, began = time.perf_counter() - began, time.perf_counter()
        solver.solve(FABRICS["vstiff"], setup)
        second = time.perf_counter() - began
        if _ == 0:
            start = first + second
    return {"first_seconds": round(start, 2), "next_seconds": round(second, 2)}


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--cells", type=float, nargs="+", default=[10.0, 5.0], help="mm")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--prior", type=int, default=11, help="fabrics drawn from the prior")
    parser.add_argument("--fabrics", nargs="+", default=list(FABRICS), choices=list(FABRICS))
    parser.add_argument(
        "--peer", nargs="*", default=["medium"], choices=list(FABRICS), help="fabrics MuJoCo drapes too"
    )
    add_json_option(parser, "solver")
    options = parser.parse_args()
    has_peer = importlib.util.find_spec("mujoco") is not None
    if options.peer and not has_peer:
        print("MuJoCo is not installed (pip install -e .[bench]): no ratio")
    results: dict[str, Any] = {"machine": platform.processor() or platform.machine(), "rows": []}
    results["compile"] = compiled(GridMesh(0.02))
    print(f"first drape at 20 mm {results['compile']['first_seconds']} s, next {results['compile']['next_seconds']} s")
    for cells in options.cells:
        mesh = GridMesh(1e-3 * cells)
        solver = Solver(mesh)
        solver.solve(FABRICS["vstiff"], Setup.nominal(Scene.HANGING))
        for name in options.fabrics:
            for scene in Scene:
                row = {"cells_mm": cells, "fabric": name, "scene": scene.value}
                row |= timed(solver, FABRICS[name], scene, options.seeds)
                line = (
                    f"{cells:4g} mm {name:7} {scene.value:8} {row['seconds']:8.2f} s  still {row['still']}/{row['of']}"
                )
                if has_peer and name in options.peer:
                    row["mujoco"] = peer(name, scene, mesh)
                    row["ratio"] = round(row["mujoco"]["seconds"] / row["seconds"], 1)
                    line += (
                        f"  MuJoCo {row['mujoco']['seconds']} s (at rest: {row['mujoco']['at_rest']}): {row['ratio']} x"
                    )
                results["rows"].append(row)
                print(line, flush=True)
        for scene in Scene if options.prior else ():
            row = {"cells_mm": cells, "fabric": "prior", "scene": scene.value} | prior(solver, scene, options.prior)
            results["rows"].append(row)
            print(
                f"{cells:4g} mm prior   {scene.value:8} {row['median_seconds']:8.2f} s median, "
                f"{row['p90_seconds']} s p90, still {row['still']}/{row['of']}",
                flush=True,
            )
    results["peak_rss_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    print(f"peak memory {results['peak_rss_mb']} MB")
    options.json.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
