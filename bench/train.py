"""How fast the loader reads and a network trains, on one core; prints a table and writes JSON.

python bench/train.py --store store.zarr --out bench-train.json
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import torch

from trainer.augment import Augmenter
from trainer.config import AugmentConfig, NetworkConfig
from trainer.dataset import PairStream, batches
from trainer.network import DrapeNetwork
from trainer.preprocess import network_images
from trainer.store_source import StoreSource


def loader_rate(store: str, size: int, pictures: int, *, passes: int = 1) -> float:
    """Pictures a CPU second in this process; of the last of the passes over the same pictures."""
    source = StoreSource(store)
    table = source.table()
    table = table.of_materials(torch.unique(torch.from_numpy(table.material[:pictures])).numpy())
    stream = PairStream(source, table, size=size, passes=passes)
    source.read(table.row[:1])  # what is imported and opened once is not counted
    count, steps = 0, 0
    per_pass = len(table)
    started = time.process_time()
    for batch in batches(stream, 16):
        count += int(batch.present.sum())
        if count >= (passes - 1) * per_pass and steps == 0 and passes > 1:
            started, steps = time.process_time(), count
    return (count - steps) / (time.process_time() - started)


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
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--store", required=True)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--pictures", type=int, default=1500)
    options = parser.parse_args()
    torch.set_num_threads(1)
    results: dict[str, dict[str, float]] = {"loader pictures/s": {}, "augment ms": {}, "forward+backward ms": {}}
    for size in (256, 128):
        results["loader pictures/s"][f"{size}, first pass"] = loader_rate(options.store, size, options.pictures)
    results["loader pictures/s"]["128, from the cache"] = loader_rate(options.store, 128, options.pictures, passes=2)
    for size, width in ((256, 1.0), (128, 1.0), (128, 0.5), (128, 0.25), (64, 0.25)):
        config = NetworkConfig(input_size=size, trunk_width=width, height_channel=True)
        augment, step = step_seconds(config)
        results["augment ms"][f"{size}"] = 1e3 * augment
        results["forward+backward ms"][f"{size} x {width:g}"] = 1e3 * step
    for quantity, values in results.items():
        for name, value in values.items():
            print(f"{quantity:22s} {name:20s} {value:8.1f}")
    if options.out is not None:
        options.out.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
