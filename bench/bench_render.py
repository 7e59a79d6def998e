"""How long pictures take on one core, and whether memory stays flat.

    python bench/bench_render.py [--renders 500] [--json render.json]

Prints a table and writes the numbers. Means of CPU time, the offscreen renderer's child included; a
smooth hanging-like surface on the meshes of the solver, so that no simulation is needed.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from results import add_json_option

from renderer.camera import CANONICAL_CAMERA, Camera, frontal_pose
from renderer.depth import render_depth, render_depths
from renderer.depth_png import quantise_depth
from renderer.filament import filament_process
from renderer.pose import INCLINATIONS_DEG
from renderer.sensor import SR300_LIKE
from renderer.shade import ShadedRenderer
from simcore.errors import MissingResourceError
from simcore.mesh import GridMesh

CAMERAS = {"256x256": CANONICAL_CAMERA, "640x480": Camera(640, 480, 475.0, 475.0, 319.5, 239.5)}
POSE = frontal_pose()


def surface(mesh: GridMesh) -> NDArray[np.float64]:
    """Folds that grow towards the hem [m]."""
    u, v = mesh.material_coordinates.T
    return np.stack([0.8 * (u - 0.25), -v, 0.08 * v * (1.2 + np.sin(30.0 * u))], axis=1)


def cpu_seconds() -> float:
    """CPU seconds of this process and of the offscreen renderer's child."""
    total = time.process_time()
    child = filament_process().pid
    if child is not None:
        fields = Path(f"/proc/{child}/stat").read_text().rsplit(")", 1)[1].split()
        total += (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return total


def milliseconds(work: Callable[[], object], repeats: int = 15) -> float:
    """Mean CPU milliseconds of a call."""
    work()
    start = cpu_seconds()
    for _ in range(repeats):
        work()
    return round(1e3 * (cpu_seconds() - start) / repeats, 1)


def resident_mb() -> float:
    """Resident memory of this process and of the offscreen renderer's child [MB]."""
    pages = 0
    for process in ("self", filament_process().pid):
        if process is not None:
            pages += int(Path(f"/proc/{process}/statm").read_text().split()[1])
    return round(pages * os.sysconf("SC_PAGE_SIZE") / 1e6, 1)


def memory(work: Callable[[], object], renders: int) -> dict[str, float]:
    """Resident memory after a tenth of ``renders`` calls, at the end, and at its highest [MB]."""
    levels = []
    for _ in range(renders):
        work()
        levels.append(resident_mb())
    return {"renders": renders, "early_mb": levels[renders // 10], "late_mb": levels[-1], "highest_mb": max(levels)}


def depth_rows() -> list[dict[str, Any]]:
    """Depth pictures: one view, eleven inclinations, and the sensor on top."""
    rows = []
    for resolution in (0.01, 0.005):
        mesh = GridMesh(resolution)
        vertices = surface(mesh)
        for name, camera in CAMERAS.items():
            one = milliseconds(lambda v=vertices, t=mesh.triangles, c=camera: render_depth(v, t, c, POSE))
            many = milliseconds(
                lambda v=vertices, t=mesh.triangles, c=camera: render_depths(v, t, c, POSE, INCLINATIONS_DEG), 5
            )
            depth, rng = render_depth(vertices, mesh.triangles, camera, POSE), np.random.default_rng(0)
            sensor = milliseconds(
                lambda d=depth, c=camera, r=rng: quantise_depth(SR300_LIKE.apply(d, r, camera=c), 1e-4)
            )
            rows.append(
                {
                    "what": "depth",
                    "picture": name,
                    "mesh_mm": 1e3 * resolution,
                    "one_view_ms": one,
                    "view_of_11_ms": round(many / len(INCLINATIONS_DEG), 2),
                    "sensor_ms": sensor,
                }
            )
    return rows


def shade_rows() -> list[dict[str, Any]]:
    """Shaded pictures by both engines; ``filament`` is skipped, and says so, without a Vulkan device."""
    rows: list[dict[str, Any]] = []
    for engine in ("raycast", "filament"):
        for resolution in (0.01, 0.005):
            mesh = GridMesh(resolution)
            vertices = surface(mesh)
            for supersample in (1, 2):
                row: dict[str, Any] = {
                    "what": f"shaded, {engine}",
                    "picture": "256x256",
                    "mesh_mm": 1e3 * resolution,
                    "samples": supersample**2,
                }
                try:
                    shader = ShadedRenderer(CANONICAL_CAMERA, engine=engine, supersample=supersample)
                except MissingResourceError as error:
                    rows.append({**row, "skipped": str(error)})
                    continue
                start = time.perf_counter()
                shader.render(vertices, mesh.triangles, mesh.uv, POSE)
                row["first_s"] = round(time.perf_counter() - start, 2)
                row["one_view_ms"] = milliseconds(
                    lambda s=shader, v=vertices, m=mesh: s.render(v, m.triangles, m.uv, POSE), 9
                )
                rows.append(row)
    return rows


def engines_agree() -> dict[str, Any]:
    """Grey levels between the two engines on the same surface, inside the cloth."""
    mesh = GridMesh(0.01)
    vertices = surface(mesh)
    try:
        ray, filament = (
            ShadedRenderer(CANONICAL_CAMERA, engine=e, supersample=1).render(vertices, mesh.triangles, mesh.uv, POSE)
            for e in ("raycast", "filament")
        )
    except MissingResourceError as error:
        return {"skipped": str(error)}
    both = (ray > 0) & (filament > 0)
    difference = np.abs(ray.astype(int) - filament.astype(int))[both]
    return {
        "outline_iou": round(float(both.sum() / ((ray > 0) | (filament > 0)).sum()), 5),
        "mean_levels": round(float(difference.mean()), 3),
        "max_levels": int(difference.max()),
    }


def memory_rows(renders: int) -> list[dict[str, Any]]:
    """Memory over many renders of changing meshes."""
    mesh = GridMesh(0.01)
    base = surface(mesh)
    count = iter(range(10**9))

    def vertices() -> NDArray[np.float64]:
        return base * (1.0, 1.0, 1.0 + 1e-4 * next(count))

    rows: list[dict[str, Any]] = [
        {
            "what": "memory, depth",
            **memory(lambda: render_depth(vertices(), mesh.triangles, CANONICAL_CAMERA, POSE), renders),
        }
    ]
    for engine in ("raycast", "filament"):
        try:
            shader = ShadedRenderer(CANONICAL_CAMERA, engine=engine)
        except MissingResourceError as error:
            rows.append({"what": f"memory, {engine}", "skipped": str(error)})
            continue
        rows.append(
            {
                "what": f"memory, {engine}",
                **memory(lambda s=shader: s.render(vertices(), mesh.triangles, mesh.uv, POSE), renders),
            }
        )
    return rows


def main() -> None:
    """Run everything, print a table, write JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--renders", type=int, default=500, help="renders of the memory test")
    add_json_option(parser, "render")
    options = parser.parse_args()
    rows = depth_rows() + shade_rows() + memory_rows(options.renders)
    for row in rows:
        print("  ".join(f"{key} {value}" for key, value in row.items()))
    agreement = engines_agree()
    print("engines agree:", agreement)
    document = {"machine": platform.processor() or platform.machine(), "rows": rows, "engines_agree": agreement}
    options.json.write_text(json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    main()
