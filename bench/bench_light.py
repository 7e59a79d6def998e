"""What a solver process costs besides its drapes: compilation cold and cached, and memory over many drapes.

    python bench/bench_light.py [--cells 10 5] [--drapes 200 40] [--fabrics 12] [--json light.json]

Each measurement is a process of its own; the first has an empty kernel cache, the second finds it filled. Compilation
is the time of the first solver and its first drape, Taichi's start included, beyond that of a second solver's; "more"
that of the kernels of turned grain and of curvatures, which a process compiles when it first needs them. Memory: the
resident memory (MiB) after each drape of fabrics of the prior, the scenes in turn, in a process that does nothing else,
and the most that it ever had. Fewer drapes at 5 mm by default, which cost four times as much. With ``--fabrics`` only
so many fabrics are draped, again and again: what then grows from round to round is not the need of one fabric more.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile

import numpy as np
from results import add_json_option

COMPILING = """
import json, time
began = time.process_time()
from simcore.mechanics import Mechanics, UniformCurvature
from simcore.mesh import GridMesh
from simcore.parameters import FabricParameters
from simcore.scenes import Scene, Setup
from simcore.solver import Solver
imported = time.process_time()
fabric, setup = FabricParameters(3000, 2500, 1000, 2.5e-4, 2.5e-4, 2.5e-4, 0.4), Setup.nominal(Scene.HANGING)
mechanics = Mechanics(off_grain_rad=0.1, rest_curvature=(UniformCurvature(2.0),))  # their kernels, too
def drape():
    moments = [time.process_time()]
    solver = Solver(GridMesh(0.05))
    for own in (Mechanics(), mechanics):
        solver.solve(fabric, setup, mechanics=own)
        moments.append(time.process_time())
    return moments[1] - moments[0], moments[2] - moments[1]
first, second, other = drape(), drape(), drape()  # the last of nothing new: nothing is compiled again
print(json.dumps({"import_s": imported - began, "compile_s": first[0] - second[0],
                  "compile_more_s": first[1] - second[1], "again_s": sum(second) - sum(other)}))
"""

DRAPING = """
import json, os, resource, sys
from pathlib import Path
from simcore.mesh import GridMesh
from simcore.parameters import FabricParameters
from simcore.prior import FabricPrior
from simcore.scenes import Scene, Setup
from simcore.solver import Solver
cells, drapes, fabrics = float(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
def rss():
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20
solver = Solver(GridMesh(1e-3 * cells))
seen = []
known = FabricPrior.default().sample_array(range(fabrics), seed=11)
for n in [number % fabrics for number in range(drapes)]:
    values = known[n]
    solver.solve(FabricParameters(*map(float, values)), Setup.nominal(list(Scene)[n % 2]), seed=n)
    seen.append(rss())
print(json.dumps({"drapes": drapes, "after_10_mib": seen[min(9, drapes - 1)], "after_half_mib": seen[drapes // 2],
                  "mib_a_drape_of_last_half": (seen[-1] - seen[drapes // 2]) / max(drapes - 1 - drapes // 2, 1),
                  "last_mib": seen[-1], "round_ends_mib": seen[fabrics - 1 :: fabrics], "most_between_mib": max(seen),
                  "peak_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10}))
"""


def run(program: str, *arguments: str, cache: str) -> dict[str, float | list[float]]:
    """A program of its own in a process of its own; its last line is JSON."""
    environment = os.environ | {"DRAPEMETER_KERNEL_CACHE": cache, "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-c", program, *arguments], env=environment, capture_output=True, text=True, check=True
    )
    result = json.loads(done.stdout.splitlines()[-1])
    return {name: np.round(value, 2).tolist() for name, value in result.items()}


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--cells", type=float, nargs="+", default=[10.0, 5.0], help="mm")
    parser.add_argument("--drapes", type=int, nargs="+", default=[200, 40], help="for each size of cells")
    parser.add_argument("--fabrics", type=int, help="so many, in turn; by default another one for each drape")
    add_json_option(parser, "light")
    options = parser.parse_args()
    if len(options.cells) != len(options.drapes):
        parser.error("give as many --drapes as --cells")
    with tempfile.TemporaryDirectory() as cache:
        results = {"cold": run(COMPILING, cache=cache), "cached": run(COMPILING, cache=cache)}
        for name, values in results.items():
            print(name, values, flush=True)
        for cells, drapes in zip(options.cells, options.drapes, strict=True):
            name = f"memory_{cells:g}_mm"
            results[name] = run(DRAPING, str(cells), str(drapes), str(options.fabrics or drapes), cache=cache)
            print(name, results[name], flush=True)
    options.json.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
