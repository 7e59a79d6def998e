"""Drapes a second of the batch solver against the single one on one core, in the same run.

    python bench/bench_batch.py [--arch cuda] [--cells 10] [--fabrics 64] [--most 256] [--single 6] [--json batch.json]

Fabrics of the prior, both scenes. Compilation is left out of both by a first batch of two. On ``cpu`` the batch has
no advantage to show: there it is the code path of the GPU, run to see that it works.
"""

from __future__ import annotations

import argparse
import json
import time

import torch
from results import add_json_option

from simcore.batch.alone import Alone
from simcore.batch.request import Request
from simcore.batch.solver import BatchSolver, memory_bytes
from simcore.mesh import GridMesh
from simcore.parameters import FabricParameters
from simcore.prior import FabricPrior
from simcore.scenes import Scene, Setup


def requests(count: int) -> list[Request]:
    """Both scenes of each fabric."""
    drawn = FabricPrior.default().sample_array(range(count), seed=11)
    return [
        Request(FabricParameters(*map(float, values)), Setup.nominal(scene), seed=n)
        for n, values in enumerate(drawn)
        for scene in Scene
    ]


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--arch", choices=["cuda", "cpu"], default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--cells", type=float, default=10.0, help="mm")
    parser.add_argument("--fabrics", type=int, default=64)
    parser.add_argument("--most", type=int, default=256, help="samples worked on at once")
    parser.add_argument("--single", type=int, default=6, help="fabrics that the single solver drapes too")
    add_json_option(parser, "batch")
    options = parser.parse_args()
    mesh = GridMesh(1e-3 * options.cells)
    wanted = requests(options.fabrics)
    batch = BatchSolver(mesh, options.arch, most=min(options.most, len(wanted)))
    batch.solve(wanted[:2])
    batch.put_up_again, batch.put_up_again_s = 0, 0.0
    gpu = options.arch == "cuda"
    if gpu:
        torch.cuda.reset_peak_memory_stats()
    began = time.perf_counter()
    drapes = batch.solve(wanted)
    wall = time.perf_counter() - began
    single = Alone(mesh, processes=1).solve([wanted[0], *wanted[: 2 * options.single]], None)[1:]  # Taichi on the CPU
    seconds = [drape.seconds for drape in single]
    result = {
        "arch": options.arch,
        "device": torch.cuda.get_device_name() if gpu else "a core",
        "cells_mm": options.cells,
        "drapes": len(drapes),
        "at_once": batch.most,
        "still": sum(drape.ok for drape in drapes),
        "put_up_again": batch.put_up_again,
        "wall_s": round(wall, 2),
        "of_which_put_up_again_s": round(batch.put_up_again_s, 2),
        "drapes_per_s": round(len(drapes) / wall, 3),
        "single_drapes_per_s": round(len(seconds) / sum(seconds), 3),
        "times_one_core": round(len(drapes) / wall * sum(seconds) / len(seconds), 2),
        "device_mb_a_sample_by_count": memory_bytes(mesh) // 2**20,
        "device_mb_a_sample": round(torch.cuda.max_memory_allocated() / 2**20 / batch.most, 1) if gpu else None,
    }
    for name, value in result.items():
        print(f"{name:28} {value}")
    options.json.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
