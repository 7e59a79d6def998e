"""How far repeats of one fabric lie apart in depth, beside how far fabrics do.

    python bench/bench_jitter.py [--cells 10] [--seeds 5] [--figure docs/pictures/jitter.png] [--json jitter.json]

Root mean square over the pixels where both pictures show cloth, 256 x 256, frontal, perfect sensor. Other fabrics: the
same seed, all pairs.
"""

from __future__ import annotations

import argparse
import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
from fabrics import FABRICS
from numpy.typing import NDArray
from results import add_json_option

from renderer.camera import CANONICAL_CAMERA, frontal_pose
from renderer.depth import render_depth
from simcore.mechanics import Jitter
from simcore.mesh import GridMesh
from simcore.scenes import Scene, Setup
from simcore.solver import Solver

Depth = NDArray[np.float32]
CHOSEN = ("stiff", "medium", "soft")


def pictures(solver: Solver, name: str, scene: Scene, seeds: int, jitter: Jitter) -> list[Depth]:
    """Depth without the panel, NaN where there is no cloth."""
    found = []
    for seed in range(seeds):
        drape = solver.solve(FABRICS[name], Setup.nominal(scene), seed=seed, jitter=jitter, time_limit_s=120.0)
        depth = render_depth(drape.vertices, solver.mesh.triangles, CANONICAL_CAMERA, frontal_pose(), panel=False)
        found.append(np.where(np.isfinite(depth) & (depth > 0.0), depth, np.nan).astype(np.float32))
    return found


def apart_mm(a: Depth, b: Depth) -> float:
    """Root mean square difference [mm]."""
    return 1e3 * float(np.sqrt(np.nanmean((a.astype(np.float64) - b) ** 2)))


def measure(
    solver: Solver, seeds: int, jitter: Jitter
) -> tuple[list[dict[str, Any]], dict[tuple[str, str], list[Depth]]]:
    """A row a fabric and scene."""
    shown = {(n, s.value): pictures(solver, n, s, seeds, jitter) for n in CHOSEN for s in Scene}
    rows = []
    for (name, scene), own in shown.items():
        repeats = [apart_mm(a, b) for a, b in itertools.combinations(own, 2)]
        others = [
            apart_mm(a, b)
            for (other, where), theirs in shown.items()
            if where == scene and other != name
            for a, b in zip(own, theirs, strict=True)
        ]
        rows.append(
            {
                "fabric": name,
                "scene": scene,
                "repeats_mm": round(float(np.mean(repeats)), 2),
                "least_mm": round(min(repeats), 2),
                "most_mm": round(max(repeats), 2),
                "other_fabrics_mm": round(float(np.mean(others)), 2),
            }
        )
    return rows, shown


def draw(shown: dict[tuple[str, str], list[Depth]], path: Path) -> None:
    """A row of repeats for each fabric and scene."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    columns = min(5, min(len(own) for own in shown.values()))
    figure, axes = plt.subplots(len(shown), columns, figsize=(1.5 * columns, 1.5 * len(shown)), squeeze=False)
    for row, ((name, scene), own) in zip(axes, shown.items(), strict=True):
        for axis, depth in zip(row, own, strict=False):
            axis.imshow(depth[30:226, 30:226], cmap="viridis_r", vmin=0.75, vmax=0.9)
            axis.set_xticks([])
            axis.set_yticks([])
        row[0].set_ylabel(f"{name}\n{scene}", fontsize=7)
    figure.tight_layout(pad=0.3)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=90)
    plt.close(figure)


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--cells", type=float, default=10.0, help="mm")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--figure", type=Path, default=Path("out/bench/jitter.png"))
    add_json_option(parser, "jitter")
    options = parser.parse_args()
    rows, shown = measure(Solver(GridMesh(1e-3 * options.cells)), options.seeds, Jitter())
    print("fabric   scene     repeats: mean (least - most) mm    other fabrics mm")
    for row in rows:
        print(
            f"{row['fabric']:8} {row['scene']:8} {row['repeats_mm']:8.2f} "
            f"({row['least_mm']:.2f} - {row['most_mm']:.2f})          {row['other_fabrics_mm']:8.2f}"
        )
    options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    draw(shown, options.figure)


if __name__ == "__main__":
    main()
