"""The drape distance's own cost: features once a render against pairwise calls, and a query of 200 fabrics.

    python bench/bench_metric.py [--fabrics 200] [--json metric.json]

Prints a table and writes the numbers. CPU time of one thread; pictures of smooth surfaces like cloth
through the real renderer, so that no simulation is needed. LPIPS needs its weights (``DRAPEMETER_WEIGHTS``).
"""

from __future__ import annotations

import argparse
import json
import platform
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from results import add_json_option

from metric.descriptor import DescriptorStore, FabricDescriptor, describe, descriptor_key
from metric.drape_distance import drape_distance
from metric.feature_cache import FeatureCache
from metric.index import FabricIndex
from metric.library import LibraryFabric
from metric.lpips_backend import LpipsBackend, lpips_range
from metric.render import DrapeRender
from metric.search import search_library
from metric.simulate import SimulationPlan
from metric.sketch import Sketched
from renderer.camera import CANONICAL_CAMERA, frontal_pose
from renderer.shade import ShadedRenderer
from simcore.mesh import GridMesh
from simcore.prior import FabricPrior
from simcore.scenes import Scene

SIMULATIONS = 5
SHADER = ShadedRenderer(CANONICAL_CAMERA)
MESH = GridMesh(0.01)


def renders(softness: float, seed: int) -> dict[Scene, list[DrapeRender]]:
    """Pictures of one made-up fabric: folds by softness, repeats that differ."""
    rng = np.random.default_rng(seed)
    u, v = MESH.material_coordinates.T
    found: dict[Scene, list[DrapeRender]] = {}
    for scene, depth in ((Scene.HANGING, 0.08), (Scene.STRETCH, 0.02)):
        found[scene] = []
        for _ in range(SIMULATIONS):
            phase, bend = rng.normal(0, 0.4), rng.normal(0, 0.1)
            z = depth * (0.2 + v) * (1.1 + np.sin(6.0 * softness * u + phase + bend * v * 20))
            vertices = np.stack([0.85 * (u - 0.25), -v, z], axis=1)
            shaded = SHADER.render(vertices, MESH.triangles, MESH.uv, frontal_pose())
            found[scene].append(DrapeRender(shaded=shaded))
    return found


def cpu_and_wall(work: Callable[[], Any], repeats: int = 1) -> tuple[float, float, Any]:
    """Mean CPU and wall-clock seconds of a call, and its last result."""
    cpu, wall, result = time.process_time(), time.perf_counter(), None
    for _ in range(repeats):
        result = work()
    return (time.process_time() - cpu) / repeats, (time.perf_counter() - wall) / repeats, result


def pairwise(backend: LpipsBackend, a: list[DrapeRender], b: list[DrapeRender]) -> np.ndarray:
    """IM by the lpips package's own forward, one call a pair: 2N² passes."""
    first, second = ([torch.from_numpy(lpips_range(r.need_shaded()))[None] for r in sets] for sets in (a, b))
    with torch.inference_mode():
        return np.array([[backend.model(x, y).item() for y in second] for x in first])


def measure_passes(backend: LpipsBackend) -> dict[str, float]:
    """The metric part of one distance at N = 5, both ways, in this one run."""
    a, b = renders(2.0, 1), renders(3.0, 2)
    drape_distance(a, b, backend)
    pairwise(backend, a[Scene.HANGING][:1], b[Scene.HANGING][:1])
    once, _, found = cpu_and_wall(lambda: drape_distance(a, b, backend, cache=FeatureCache()), 3)
    every, _, tables = cpu_and_wall(lambda: {s: pairwise(backend, a[s], b[s]) for s in a})
    difference = max(float(np.abs(found.tables[s] - tables[s]).max()) for s in a)
    return {
        "once_a_render_s": once,
        "pairwise_calls_s": every,
        "times_faster": every / once,
        "largest_difference": difference,
    }


def measure_search(backend: LpipsBackend, fabrics: int) -> dict[str, float]:
    """A query of an index in memory, of descriptors on disk, and what sketching does to a distance."""
    sketched, cache = Sketched(backend), FeatureCache(memory_bytes=0)
    softness = np.random.default_rng(0).uniform(1.0, 6.0, fabrics)
    exact_sets = [renders(float(s), 100 + k) for k, s in enumerate(softness[:12])]
    started = time.process_time()
    described = [describe(sets, sketched, cache) for sets in exact_sets]
    describing = (time.process_time() - started) / len(described)
    # The rest of the library has the same size and form; only the time of a query depends on it.
    rng = np.random.default_rng(1)
    library = described + [_shuffled(described[k % 12], rng) for k in range(fabrics - 12)]
    index = FabricIndex(sketched, library)
    index.query(library[0])
    cpu, wall, _ = cpu_and_wall(lambda: index.query(library[3]), 20)
    with tempfile.TemporaryDirectory() as folder:
        store = DescriptorStore(Path(folder))
        for k, descriptor in enumerate(library):
            store.save(str(k), descriptor)
        size = sum(p.stat().st_size for p in Path(folder).iterdir())
        cold = lambda: FabricIndex(sketched, [_loaded(Path(folder), k) for k in range(fabrics)]).query(library[3])  # noqa: E731
        _, from_disk, _ = cpu_and_wall(cold)
    ratios = []
    for a in range(12):
        found = {r.place: r.distance for r in FabricIndex(sketched, described).query(described[a])}
        for b in range(a):
            exact = drape_distance(exact_sets[a], exact_sets[b], backend).distance
            ratios.append(found[b] / exact)
    rank_cpu, rank_wall = measure_rank(backend, sketched, library)
    return {
        "fabrics": float(fabrics),
        "rank_ms": 1e3 * rank_wall,
        "rank_cpu_ms": 1e3 * rank_cpu,
        "query_ms": 1e3 * wall,
        "query_cpu_ms": 1e3 * cpu,
        "from_disk_ms": 1e3 * from_disk,
        "describe_a_fabric_s": describing,
        "kilobytes_a_fabric": size / fabrics / 1024,
        "sketch_error_std": float(np.std(ratios)),
        "sketch_error_max": float(np.abs(np.array(ratios) - 1).max()),
    }


def measure_rank(backend: LpipsBackend, sketched: Sketched, descriptors: list[FabricDescriptor]) -> tuple[float, float]:
    """CPU and wall-clock seconds of the call behind `drapemeter rank` where every fabric is cached."""
    fabrics = FabricPrior.default().sample(range(len(descriptors)))
    library = [LibraryFabric(str(k), fabric) for k, fabric in enumerate(fabrics)]
    plan = SimulationPlan(SIMULATIONS)
    reference = fabrics[0]
    store = DescriptorStore()
    for k, (fabric, descriptor) in enumerate(zip(fabrics, descriptors, strict=True)):
        # The reference is in the library, as another sample of it.
        store.save(descriptor_key(fabric, SIMULATIONS if k == 0 else 0, plan, sketched), descriptor)
    store.save(descriptor_key(reference, 0, plan, sketched), descriptors[1])
    query = lambda: search_library(reference, library, backend, plan, descriptors=store)  # noqa: E731
    query()
    return cpu_and_wall(query, 10)[:2]


def _loaded(folder: Path, number: int) -> FabricDescriptor:
    found = DescriptorStore(folder).load(str(number))
    assert found is not None
    return found


def _shuffled(descriptor: FabricDescriptor, rng: np.random.Generator) -> FabricDescriptor:
    sketches = {s: rng.permuted(rows, axis=1) for s, rows in descriptor.sketches.items()}
    return FabricDescriptor(sketches, descriptor.pictures)


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fabrics", type=int, default=200, help="size of the library searched, at least 12")
    add_json_option(parser, "metric")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    backend = LpipsBackend("squeeze")
    found = {
        "machine": {"platform": platform.platform(), "processor": platform.processor(), "torch": torch.__version__},
        "passes": measure_passes(backend),
        "search": measure_search(backend, arguments.fabrics),
    }
    for part in ("passes", "search"):
        for name, value in found[part].items():
            print(f"{part:<8} {name:<22} {value:.4g}")
    arguments.json.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
