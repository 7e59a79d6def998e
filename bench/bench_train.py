"""How fast the loader reads and a network trains, on one core.

    python bench/bench_train.py [--store store.zarr] [--json train.json]

Prints a table and writes the numbers. CPU time; without a store of one's own, pictures of a smooth
hanging-like surface are written to a temporary one.
"""

from __future__ import annotations

import argparse
import json
import platform
import tempfile
import time
from pathlib import Path

import numpy as np
import torch
from results import add_json_option

from renderer.camera import CANONICAL_CAMERA, frontal_pose
from renderer.depth import render_depths
from renderer.depth_png import quantise_depth
from renderer.pose import INCLINATIONS_DEG
from renderer.store import RowStatus, ShardRows, StoreLayout, StoreWriter
from simcore.mesh import GridMesh
from trainer.augment import Augmenter
from trainer.config import AugmentConfig, NetworkConfig
from trainer.dataset import PairStream, batches
from trainer.network import DrapeNetwork
from trainer.preprocess import network_images
from trainer.store_source import StoreSource

MESH = GridMesh(0.02)
LAYOUT = StoreLayout(
    materials=64,
    scenes=("hanging", "stretch"),
    jitters=1,
    inclinations_deg=tuple(INCLINATIONS_DEG),
    simulations_per_shard=16,
    vertex_count=MESH.vertex_count,
)

NETWORKS = ((256, 1.0), (128, 1.0), (128, 0.5), (128, 0.25), (64, 0.25))


def write_store(path: Path) -> None:
    """A store of folds that differ from material to material."""
    u, v = MESH.material_coordinates.T
    writer = StoreWriter.create(path, LAYOUT, configuration={}, seed=0, software_version="bench")
    for shard in range(LAYOUT.shards):
        places = [LAYOUT.address(s) for s in LAYOUT.shard_simulations(shard)]
        drapes = [
            np.stack([0.8 * (u - 0.25), -v, 0.08 * v * (1.2 + np.sin((10 + m) * u + scene))], axis=1)
            for m, scene, _ in places
        ]
        pictures = [
            quantise_depth(render_depths(d, MESH.triangles, CANONICAL_CAMERA, frontal_pose(), INCLINATIONS_DEG), 1e-4)
            for d in drapes
        ]
        count = len(places) * LAYOUT.pictures
        material, scene = (np.repeat([p[k] for p in places], LAYOUT.pictures) for k in (0, 1))
        writer.write_shard(
            shard,
            ShardRows(
                depth=np.concatenate(pictures),
                parameters=np.ones((count, 7), dtype=np.float32),
                scene=scene.astype(np.uint8),
                status=np.full(count, RowStatus.OK, dtype=np.uint8),
                reason=np.full(count, "", dtype=object),
                inclination_deg=np.tile(INCLINATIONS_DEG, len(places)).astype(np.float32),
                seed=np.zeros(count, dtype=np.uint64),
                material=material.astype(np.uint32),
                jitter=np.zeros(count, dtype=np.uint32),
                vertices=np.stack(drapes).astype(np.float32),
                residual=np.zeros(len(places)),
                energy=np.zeros(len(places)),
            ),
        )


def loader_rate(store: Path, size: int, *, cached: bool = False) -> float:
    """Pictures a CPU second in this process, of the first pass or of the second, which comes from memory."""
    source = StoreSource(store)
    table = source.table()
    source.read(table.row[:1])  # what is imported and opened once is not counted
    stream = PairStream(source, table, size=size, passes=1)
    if cached:
        for _ in batches(stream, 16):
            pass
    started = time.process_time()
    count = sum(int(batch.present.sum()) for batch in batches(stream, 16))
    return count / (time.process_time() - started)


def step_seconds(config: NetworkConfig, batch: int = 16, repeats: int = 3) -> tuple[float, float]:
    """CPU seconds a picture of augmentation and of forward and backward."""
    network, augment = DrapeNetwork(config).train(), Augmenter(AugmentConfig())
    pictures = torch.rand(batch, 1, config.input_size, config.input_size) * 0.1
    network.extract(network_images(pictures, config)).mean.sum().backward()
    started = time.process_time()
    for seed in range(repeats):
        augment(pictures, seed)
    augmented = time.process_time()
    for _ in range(repeats):
        network.extract(network_images(pictures, config)).mean.sum().backward()
    done = time.process_time()
    return (augmented - started) / repeats / batch, (done - augmented) / repeats / batch


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--store", type=Path, help="a store of one's own")
    add_json_option(parser, "train")
    options = parser.parse_args()
    torch.set_num_threads(1)
    rows: list[dict[str, str | float]] = []
    with tempfile.TemporaryDirectory() as folder:
        store = options.store
        if store is None:
            store = Path(folder) / "bench.zarr"
            write_store(store)
        for size, cached in ((256, False), (128, False), (128, True)):
            what = f"loader, {size} px" + (", second pass" if cached else "")
            rows.append({"what": what, "pictures/s": round(loader_rate(store, size, cached=cached), 1)})
    for size, width in NETWORKS:
        augment, step = step_seconds(NetworkConfig(input_size=size, trunk_width=width, height_channel=True))
        times = {"augment ms": round(1e3 * augment, 2), "forward and backward ms": round(1e3 * step, 2)}
        rows.append({"what": f"step, {size} px, width {width:g}", **times})
    for row in rows:
        print("  ".join(f"{key} {value}" for key, value in row.items()))
    document = {"machine": platform.processor() or platform.machine(), "rows": rows}
    options.json.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
