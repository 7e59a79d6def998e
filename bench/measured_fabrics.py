"""The ten fabrics measured by Wang, O'Brien and Ramamoorthi (2011), embedded and searched by drape distance.

    python bench/measured_fabrics.py MEASURED.json [--simulations 5] [--resolution 0.01] [--out docs/pictures]

Writes ``measured-embedding.png`` and ``measured-search.png`` and prints the distances. Simulates 100 drapes.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from results import add_json_option
from scipy.stats import spearmanr

from metric.backends import get_backend
from metric.descriptor import thumbnail
from metric.figures import embedding_figure, search_figure, side_by_side
from metric.matrix import pair_tables
from metric.parameter_distance import ParameterDistance
from metric.render_cache import RenderCache
from metric.scaling import classical_scaling, excess_distance
from metric.simulate import SimulationPlan, simulate_fabrics
from renderer.user_cache import default_cache_folder
from simcore.parameters import FabricParameters

RIGIDITY_PER_HINGE_STIFFNESS = 0.24
"""Effective flexural rigidity over the tabulated hinge stiffness on their meshes (said beside the table)."""


def parameters(row: dict[str, Any]) -> FabricParameters:
    """Our seven numbers of a measured fabric. The tables' rows are hinge edges at 0, 45 and 90 degrees from warp: a
    hinge along warp bends the cloth's weft.
    """
    weft, bias, warp = (RIGIDITY_PER_HINGE_STIFFNESS * float(v) for v in row["bending_mean"])
    return FabricParameters(
        row["stretch_warp"], row["stretch_weft"], row["stretch_bias"], warp, weft, bias, row["density"]
    )


def main() -> None:
    """Simulate, compare, draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("measured", type=Path, help="JSON with measured_fabrics")
    parser.add_argument("--simulations", type=int, default=5)
    parser.add_argument("--resolution", type=float, default=0.01)
    parser.add_argument("--reference", default="11oz-black-denim", help="fabric to search for")
    parser.add_argument("--out", type=Path, default=Path("docs/pictures"))
    add_json_option(parser, "measured-fabrics")
    arguments = parser.parse_args()
    rows = json.loads(arguments.measured.read_text())["measured_fabrics"]["fabrics"]
    names = [row["id"] for row in rows]
    fabrics = [parameters(row) for row in rows]
    plan = SimulationPlan(arguments.simulations, arguments.resolution)
    folder = default_cache_folder()
    simulated = simulate_fabrics(fabrics, plan, cache=None if folder is None else RenderCache(folder / "renders"))
    matrix = pair_tables([s.scenes for s in simulated], get_backend("lpips")).matrix()
    scaling = classical_scaling(excess_distance(matrix))
    by_parameters = ParameterDistance.of_population(fabrics).matrix(fabrics)
    pictures = [{scene: thumbnail(sets[0]) for scene, sets in s.scenes.items()} for s in simulated]

    mesh = f"{1e3 * arguments.resolution:g} mm mesh, N = {arguments.simulations}"
    note = f"drape distance in the plane ({100 * scaling.explained:.0f} % of its spectrum); {mesh}"
    shown = [side_by_side(p) for p in pictures]
    embedding_figure(arguments.out / "measured-embedding.png", scaling.points, names, shown, title=note)
    reference = names.index(arguments.reference)
    rankings = {}
    for label, distance in (("drape (LPIPS)", matrix.distance), ("parameters (z-score)", by_parameters)):
        order = [k for k in np.argsort(distance[reference]) if k != reference]
        rankings[label] = [(names[k], float(distance[reference, k]), pictures[k]) for k in order]
    search_figure(arguments.out / "measured-search.png", pictures[reference], rankings)

    off = ~np.eye(len(names), dtype=bool)
    correlation = float(spearmanr(matrix.distance[off], by_parameters[off]).statistic)
    print(f"d(a, a) < d(a, b) in {100 * matrix.self_nearest_share:.1f} % of ordered pairs; {note}")
    print(f"Spearman correlation of drape and parameter distances over all pairs: {correlation:.2f}")
    for k, name in enumerate(names):
        nearest = [j for j in np.argsort(matrix.distance[k]) if j != k][:3]
        others = ", ".join(f"{names[j]} {matrix.distance[k, j]:.3f}" for j in nearest)
        print(f"{name:<20} {scaling.points[k].round(3)}  d(a,a) {matrix.distance[k, k]:.3f}  nearest {others}")
    found = {"names": names, "distance": matrix.distance.tolist(), "error": matrix.standard_error.tolist()}
    arguments.json.write_text(json.dumps({**found, "points": scaling.points.tolist()}, indent=1))


if __name__ == "__main__":
    main()
