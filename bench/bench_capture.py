"""How far registered heights are from the truth, and how long a capture takes.

    python bench/bench_capture.py [--repeats 2] [--json capture.json]

Drapes of four fabrics in both scenes are simulated, seen by a camera of 640 x 480 pixels turned by about 8 degrees,
with and without a sensor's noise, registered, and compared with what the canonical camera sees of the same drape.
``given``: the pose is known; ``alone``: it is found in that picture; ``together``: found in all pictures of the camera.
"""

from __future__ import annotations

import argparse
import json
import platform
import time
from collections import defaultdict
from dataclasses import dataclass

import numpy as np
from fabrics import FABRICS
from numpy.typing import NDArray
from results import add_json_option
from scipy import ndimage

from capture.camera_rig import share_pose
from capture.normalise import CANONICAL_DISTANCE_M, normalise_depth
from capture.register import Registration, register
from capture.segment import segment_cloth
from renderer.camera import CANONICAL_CAMERA, Camera, frontal_pose
from renderer.depth import render_buffers, render_depth
from renderer.pose import invert_pose, pose_from_rotation
from renderer.sensor import SR300_LIKE, SensorModel
from simcore.mesh import GridMesh
from simcore.scenes import Scene, Setup
from simcore.solver import Solver

SENSORS = {"ideal": SensorModel(), "1 mm noise": SensorModel(range_noise_m=0.001), "SR300-like": SR300_LIKE}
CAMERA = Camera(640, 480, 475.0, 475.0, 325.0, 236.0)
STEP_M = 0.012


@dataclass(frozen=True)
class Case:
    """A drape, seen by the canonical camera: height [m], the cloth more than two pixels from steps."""

    setup: Setup
    vertices: NDArray[np.float64]
    height: NDArray[np.float32]
    inner: NDArray[np.bool_]


def camera_pose() -> NDArray[np.float64]:
    """A camera that looks at the sample's middle from 0.92 m, turned by 8 degrees and a little more."""
    pose = pose_from_rotation(np.radians([2.8, 8.0, 2.0]))
    pose[:3, :3] = pose[:3, :3] @ np.diag([1.0, -1.0, -1.0])
    pose[:3, 3] = np.array([0.0, 0.0, 0.92]) - pose[:3, :3] @ np.array([0.01, -0.26, 0.0])
    return pose


def simulate(repeats: int) -> list[Case]:
    """Drapes at 20 mm and what the canonical camera sees of them."""
    mesh = GridMesh(0.02)
    solver = Solver(mesh)
    cases = []
    for fabric in FABRICS.values():
        for scene in Scene:
            for seed in range(repeats):
                setup = Setup.nominal(scene)
                vertices = solver.solve(fabric, setup, seed=seed).vertices
                seen = render_buffers(vertices, mesh.triangles, CANONICAL_CAMERA, frontal_pose())
                height = (CANONICAL_DISTANCE_M - seen.depth).astype(np.float32)
                steps = ndimage.maximum_filter(height, 3) - ndimage.minimum_filter(height, 3) > STEP_M
                inner = seen.cloth & ~ndimage.binary_dilation(steps, iterations=2)
                cases.append(Case(setup, vertices, height, inner))
    return cases


def height_error_mm(case: Case, depth: NDArray[np.float32], pose: NDArray[np.float64]) -> float:
    """Root mean square over the cloth away from steps [mm]."""
    seen = normalise_depth(depth, CAMERA, pose, case.setup)
    inner = case.inner & seen.mask
    return 1e3 * float(np.sqrt(np.mean((seen.height - case.height)[inner] ** 2)))


def pose_error(found: NDArray[np.float64], true: NDArray[np.float64]) -> tuple[float, float]:
    """Shift of the panel [mm] and turn [degree]."""
    motion = invert_pose(true) @ found
    turn = np.arccos(np.clip((np.trace(motion[:3, :3]) - 1.0) / 2.0, -1.0, 1.0))
    return 1e3 * float(np.linalg.norm(motion[:3, 3])), float(np.degrees(turn))


def measure(cases: list[Case]) -> list[dict[str, object]]:
    """One row a scene, sensor and way of getting the pose."""
    true = camera_pose()
    triangles = GridMesh(0.02).triangles
    rows: list[dict[str, object]] = []
    for name, sensor in SENSORS.items():
        pictures, alone, planes, seconds = [], [], [], []
        for number, case in enumerate(cases):
            ideal = render_depth(case.vertices, triangles, CAMERA, true)
            depth = sensor.apply(ideal, np.random.default_rng(number), camera=CAMERA)
            start = time.process_time()
            region = segment_cloth(depth, CAMERA, case.setup)
            alone.append(register(depth, CAMERA, case.setup, region))
            planes.append(region.plane)
            seconds.append(time.process_time() - start)
            pictures.append(depth)
        shared = share_pose([case.setup.scene for case in cases], [lambda r=r: r for r in alone], planes)
        found: dict[str, list[Registration] | None] = {"given": None, "alone": alone, "together": shared}
        for way, registrations in found.items():
            errors: dict[Scene, list[tuple[float, float, float]]] = defaultdict(list)
            for number, (case, depth) in enumerate(zip(cases, pictures, strict=True)):
                pose = true if registrations is None else registrations[number].camera_from_panel
                errors[case.setup.scene].append((height_error_mm(case, depth, pose), *pose_error(pose, true)))
            for scene, values in errors.items():
                height, shift, turn = np.mean(values, axis=0).round(2)
                rows.append(
                    {
                        "sensor": name,
                        "pose": way,
                        "scene": scene.value,
                        "height_rms_mm": float(height),
                        "worst_mm": round(max(v[0] for v in values), 2),
                        "pose_mm": float(shift),
                        "pose_deg": float(turn),
                        "register_cpu_s": round(float(np.mean(seconds)), 3),
                    }
                )
    return rows


def normalise_ms(cases: list[Case]) -> dict[str, float]:
    """Mean CPU milliseconds of a normalisation, from another camera and of the canonical camera's own picture."""
    true, triangles = camera_pose(), GridMesh(0.02).triangles
    other = render_depth(cases[0].vertices, triangles, CAMERA, true)
    own = (CANONICAL_DISTANCE_M - cases[0].height).astype(np.float32)
    taken = {}
    for name, depth, camera, pose in (("640x480", other, CAMERA, true), ("own", own, CANONICAL_CAMERA, frontal_pose())):
        start = time.process_time()
        for _ in range(10):
            normalise_depth(depth, camera, pose, cases[0].setup)
        taken[name] = round(100.0 * (time.process_time() - start), 2)
    return taken


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=2, help="drapes of each fabric and scene")
    add_json_option(parser, "capture")
    options = parser.parse_args()
    cases = simulate(options.repeats)
    rows = measure(cases)
    taken = normalise_ms(cases)
    print(f"{'sensor':12} {'pose':9} {'scene':8} {'height rms':>10} {'worst':>9} {'pose off by':>18}")
    for row in rows:
        height = f"{row['height_rms_mm']:7.2f} mm {row['worst_mm']:6.2f} mm"
        pose = f"{row['pose_mm']:6.1f} mm {row['pose_deg']:5.2f} deg"
        print(f"{row['sensor']:12} {row['pose']:9} {row['scene']:8} {height} {pose}")
    print(f"CPU: segment and register {rows[0]['register_cpu_s']} s, normalise 640x480 {taken['640x480']} ms,", end=" ")
    print(f"a picture of the canonical camera {taken['own']} ms")
    result = {
        "machine": platform.processor(),
        "python": platform.python_version(),
        "rows": rows,
        "normalise_ms": taken,
    }
    options.json.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
