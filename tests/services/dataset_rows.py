"""Rows as a worker would write them, with made-up pictures."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from renderer.store import RowStatus, ShardRows, StoreWriter
from services.dataset.configuration import SweepConfiguration, simulation_seed
from services.dataset.fabrics import FabricTable
from services.dataset.sweep import prepare_store


def rows_of(shard: int, configuration: SweepConfiguration, fabrics: FabricTable) -> ShardRows:
    """Rows of a shard; the sweep's last simulation failed."""
    layout = configuration.layout
    numbers = layout.shard_simulations(shard)
    address = np.repeat([layout.address(number) for number in numbers], layout.pictures, axis=0)
    failed = np.repeat(np.array(numbers) == layout.simulations - 1, layout.pictures)
    rng = np.random.default_rng(shard)
    depth = rng.integers(8000, 9000, (len(address), 256, 256), dtype=np.uint16)
    depth[failed] = 0
    u, v = configuration.mesh.material_coordinates.T
    sheet = np.stack([u - 0.25, -v, 0.001 + 0.05 * np.sin(np.pi * u / 0.5)], axis=1)
    return ShardRows(
        depth=depth,
        parameters=fabrics.parameters(address[:, 0].tolist()),
        scene=address[:, 1].astype(np.uint8),
        status=np.where(failed, RowStatus.TIMED_OUT, RowStatus.OK).astype(np.uint8),
        reason=np.where(failed, "time limit", "").astype(object),
        inclination_deg=np.tile(layout.inclinations_deg, len(numbers)).astype(np.float32),
        seed=np.array([simulation_seed(configuration.seed, triple) for triple in address], dtype=np.uint64),
        material=address[:, 0].astype(np.uint32),
        jitter=address[:, 2].astype(np.uint32),
        vertices=np.repeat(sheet[None], len(numbers), axis=0).astype(np.float32),
        residual=np.zeros(len(numbers)),
        energy=np.arange(numbers.start, numbers.stop, dtype=np.float64),
    )


def made_up_store(place: Path, configuration: SweepConfiguration, fabrics: FabricTable) -> Path:
    """A whole store without a simulation."""
    prepare_store(str(place), configuration, resume=False)
    writer = StoreWriter.open(place)
    for shard in range(configuration.layout.shards):
        writer.write_shard(shard, rows_of(shard, configuration, fabrics))
    return place
