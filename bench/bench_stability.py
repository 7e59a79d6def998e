"""Fabrics of the prior on one mesh, both scenes: how many come to a certified rest, by softness.

    python bench/bench_stability.py [--cells 10] [--fabrics 500] [--first 0] [--json stability-10.jsonl]

One line of JSON a drape, appended as it ends, so that a run can be cut and gone on with (``--first``). The last thing
printed is the table of the file's lines that are of this solver, the last one of each drape. Judged here: crossings,
heights over the panel, and the residual, by the tests' NumPy reference, written apart from the kernels. Taken on the
solver's word: the status, that its Hessian has no negative eigenvalue there, and whether contact of the cloth with
itself was on.
"""

from __future__ import annotations

import argparse
import json
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from simcore.crossings import count_crossings
from simcore.mesh import GridMesh
from simcore.parameters import FabricParameters
from simcore.prior import FabricPrior
from simcore.scenes import Scene, Setup
from simcore.solver import Solver
from simcore.version import SOLVER_VERSION

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))  # for the tests' reference
from tests.simcore.judge import cloth_of, positions

SEED = 2026
BOUNDS_MM = (0.0, 12.0, 18.0, 27.0, np.inf)
"""Classes of the bending length (B / rho g)^(1/3), geometric mean of warp and weft [mm]."""


def one(solver: Solver, fabric: FabricParameters, scene: Scene, seed: int) -> dict[str, Any]:
    """Drape and judge."""
    drape = solver.solve(fabric, Setup.nominal(scene), seed=seed, time_limit_s=240.0)
    contact = solver.levels[-1].own_contact
    apart = 0 if contact is None else contact.apart
    cloth = cloth_of(drape, fabric, Setup.nominal(scene), seed=seed, own_contact=apart)
    bending = float(np.sqrt(fabric.bending_warp * fabric.bending_weft))
    return {
        "solver": SOLVER_VERSION,
        "scene": scene.value,
        "seed": seed,
        "length_mm": 1e3 * (bending / (fabric.density * 9.81)) ** (1 / 3),
        "status": drape.status.value,
        "reason": drape.reason,
        "stable": drape.stable,
        "residual": drape.residual,
        "reference_residual": cloth.residual(positions(drape)),
        "touching": apart,
        "seconds": drape.seconds,
        "lowest_m": float(drape.vertices[:, 2].min()),
        "crossings": count_crossings(drape.vertices, solver.mesh.triangles),
    }


def table(rows: list[dict[str, Any]]) -> list[str]:
    """Markdown, a line a class; the residuals are the reference's of certified drapes [vertex weights]."""
    head = ("bending length [mm]", "drapes", "certified", "behind the panel", "through itself", "largest residual")
    head += ("median s", "95%")
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    bounds = [*pairwise(BOUNDS_MM), (0.0, np.inf)]
    for low, high in bounds:
        own = [row for row in rows if low <= row["length_mm"] < high]
        if not own:
            continue
        still = [row for row in own if row["status"] == "still" and row["stable"]]
        seconds = [row["seconds"] for row in own]
        residuals = [row["reference_residual"] for row in still if "reference_residual" in row]
        name = "all" if (low, high) == bounds[-1] else f"{low:g} to {high:g}"
        lines.append(
            f"| {name} | {len(own)} | {len(still)} ({100 * len(still) / len(own):.1f} %) "
            f"| {sum(row['lowest_m'] < 0.0 for row in own)} | {sum(row['crossings'] > 0 for row in still)} "
            f"| {max(residuals, default=np.nan):.1e} "
            f"| {np.median(seconds):.1f} | {np.quantile(seconds, 0.95):.1f} |"
        )
    return lines


def own_rows(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Of this solver, each drape once, as it was draped last."""
    last = {(row["seed"], row["scene"]): row for row in rows if row.get("solver") == SOLVER_VERSION}
    return list(last.values())


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--cells", type=float, default=10.0, help="mm")
    parser.add_argument("--fabrics", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--json", type=Path, default=None)
    options = parser.parse_args()
    out = options.json or Path(f"out/bench/stability-{options.cells:g}.jsonl")
    out.parent.mkdir(parents=True, exist_ok=True)
    solver = Solver(GridMesh(1e-3 * options.cells))
    numbers = range(options.first, options.first + options.fabrics)
    for number, values in zip(numbers, FabricPrior.default().sample_array(numbers, seed=SEED), strict=True):
        fabric = FabricParameters(*map(float, values))
        with out.open("a", encoding="utf-8") as file:
            for scene in Scene:
                file.write(json.dumps(one(solver, fabric, scene, number)) + "\n")
    rows = own_rows([json.loads(line) for line in out.read_text(encoding="utf-8").splitlines()])
    print("\n".join(table(rows)))
    for row in rows:
        if row["status"] != "still":
            print(f"fabric {row['seed']} {row['scene']}: {row['status']}, {row['reason']}")


if __name__ == "__main__":
    main()
