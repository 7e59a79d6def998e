"""Captures by another simulator of cloth (``bench.hinge_cloth``): is what was put into them found?

    python bench/bench_other_simulator.py make FOLDER [--sets "none;panel_tilt=8"] [--workers 2] [--seed 91] [--cells 5]
    python bench/bench_other_simulator.py diagnose FOLDER [--sets ...] [--seed 91] [--cells 5]

Four fabrics, both scenes, two repeats; stated parameters 7 % off; magnets that hold a point. Sets that stand already
are kept, so that a stopped run goes on; each seed and each finer mesh has a folder of its own; ``diagnose`` writes
``report.json`` beside each set and prints a table. On cells finer than 10 mm a drape goes on from its rest on those.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
from hinge_cloth import HingeCloth
from numpy.typing import NDArray
from triangle_mesh import Mesh, carried

from capture.capture_set import CaptureSet
from diagnosis.diagnose import DiagnosisOptions, diagnose
from diagnosis.effects import parse_effect
from diagnosis.scene import SimulationScene
from diagnosis.simulation.drape_cache import DrapeCache, content_key
from diagnosis.synthesis import SynthesisPlan, make_capture_set
from renderer.depth import render_depth
from simcore.parameters import FabricParameters

CELL_M = 0.010
PLAN = SynthesisPlan(fabrics=4, pin_radius_m=0.0, seed=91)
SETS = (
    "none",
    "wrong bending_weft=2.5",
    "rest_curvature=8",
    "panel_tilt=8",
    "air_draft=0.25",
    "pin_spacing=0.006",
    "pin_drop=0.007",
    "corner_pull=0.006",
    "off_grain=8",
    "hem_weight=25",
    "stretch_stiffening=0.03",
    "camera_rotation=rx:0.6,ry:-0.4,rz:0.5",
    "depth_bias=0.007",
    "focal_scale=0.015",
    "range_noise=0.0025",
    "sensor_smoothing=1.2",
    "edge_flying_pixels=0.5",
    "rest_curvature=8 pin_spacing=0.007",
    "off_grain=9 depth_bias=0.007",
    "panel_tilt=9 sensor_smoothing=1.2",
)


@cache
def _mesh(size_m: tuple[float, float], cell_m: float) -> Mesh:
    return Mesh.of(size_m, cell_m, 5)


def _drape(
    fabric: FabricParameters, scene: SimulationScene, words: tuple[int, ...], cell_m: float, shelf: DrapeCache
) -> tuple[NDArray[np.float64], float]:
    """Vertices [m] and what is left out of balance [weights of one]; on finer cells from the rest on 10 mm."""
    key = content_key(
        hinges=fabric,
        setup=scene.setup,
        mechanics=scene.mechanics,
        words=words,
        **({} if cell_m == CELL_M else {"cell": cell_m}),
    )
    kept = shelf.get_arrays(key)
    if kept is None:
        mesh = _mesh(scene.setup.sample_size_m, cell_m)
        cloth = HingeCloth(mesh, fabric, scene, int(np.random.SeedSequence(words).generate_state(1)[0]))
        if cell_m < CELL_M:
            coarse, _ = _drape(fabric, scene, words, CELL_M, shelf)
            vertices, left = cloth.settle(carried(coarse, _mesh(scene.setup.sample_size_m, CELL_M), mesh))
        else:
            vertices, left = cloth.drape()
        kept = {"vertices": vertices, "left": np.array([left])}
        shelf.put_arrays(key, kept)
    return kept["vertices"], float(kept["left"][0])


def picture(
    fabric: FabricParameters,
    scene: SimulationScene,
    words: tuple[int, ...],
    *,
    shelf: DrapeCache,
    cell_m: float = CELL_M,
) -> NDArray[np.float32]:
    """The other simulator's ideal depth picture [m]; its drapes are kept, for sets that differ in the camera alone."""
    vertices, left = _drape(fabric, scene, words, cell_m, shelf)
    print(f"  {words} left {left:.1e} weights, lowest {1e3 * vertices[:, 2].min():.2f} mm", flush=True)
    mesh = _mesh(scene.setup.sample_size_m, cell_m)
    return render_depth(vertices, mesh.triangles, scene.camera, scene.camera_from_panel, panel=scene.setup.panel)


def make_one(name: str, folder: Path, seed: int, cell_m: float) -> None:
    """One capture set, unless it stands."""
    target = folder / _file(name)
    if (target / "captures.json").exists():
        return
    wrong = name.removeprefix("wrong ").split("=") if name.startswith("wrong ") else None
    plan = replace(PLAN, seed=seed, wrong=None if wrong is None else (wrong[0], float(wrong[1])))
    effects = [] if wrong or name == "none" else [parse_effect(text) for text in name.split()]
    shelf = DrapeCache(folder.parent / f"seed-{seed}" / "drapes")
    make_capture_set(target, plan, effects, name=name, pictures=partial(picture, shelf=shelf, cell_m=cell_m))


def _file(name: str) -> str:
    return "".join(c if c.isalnum() or c in "._-" else "-" for c in name)


def report_row(name: str, folder: Path, shelf: DrapeCache) -> str:
    """Diagnose one set; a line of the table."""
    target = folder / _file(name)
    path = target / "report.json"
    if not path.exists():
        made = diagnose(CaptureSet.load(target), DiagnosisOptions(), cache=shelf).report
        path.write_text(json.dumps(made.as_json(), indent=1))
    report = json.loads(path.read_text())
    cause, gap = report["cause"], report["gap"]
    likely = sorted(cause["probabilities"].items(), key=lambda item: -item[1])[:3]
    said = ", ".join(f"`{k}` {v:.2f}" for k, v in likely if v >= 0.02)
    sizes = "; ".join(f"{e['name']} {_number(e['magnitude'])}" for e in cause["effects"])
    return f"| {name} | {gap['value']:.2f}, {gap['noise_floor']:.2f} | {gap['p_value']:.3f} | {said} | {sizes} |"


def _number(value: float | dict[str, float]) -> str:
    return ", ".join(f"{v:.3g}" for v in (value.values() if isinstance(value, dict) else [value]))


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("make", "diagnose"))
    parser.add_argument("folder", type=Path)
    parser.add_argument("--sets", default=";".join(SETS), help="separated by semicolons")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--seed", type=int, default=PLAN.seed, help="of fabrics, captures and noise")
    parser.add_argument("--cells", type=float, default=1e3 * CELL_M, help="mm, of the other simulator's mesh")
    given = parser.parse_args(arguments)
    cell_m = round(1e-3 * given.cells, 6)
    finer = "" if cell_m == CELL_M else f"-{given.cells:g}mm"
    names, folder = given.sets.split(";"), given.folder / f"seed-{given.seed}{finer}"
    if given.what == "make":
        with ProcessPoolExecutor(given.workers) as pool:
            list(pool.map(partial(make_one, folder=folder, seed=given.seed, cell_m=cell_m), names))
        return
    print("| in it | gap, floor [mm] | p | probabilities | size |\n|---|---|---|---|---|")
    for name in names:
        print(report_row(name, folder, DrapeCache(folder / "states")), flush=True)


if __name__ == "__main__":
    main()
