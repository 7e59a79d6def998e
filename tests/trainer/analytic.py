"""Analytic cloth for the estimator's tests: surfaces whose shape tells the parameters, no solver needed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from trainer.dataset import PictureTable

LOG_CENTRE = np.log([500.0, 400.0, 100.0, 2e-5, 1e-5, 1.5e-5, 0.2])


@dataclass(frozen=True)
class AnalyticSource:
    """Folds: their number follows the bending, their lean the warp stretch, their height the density."""

    materials: int = 60
    jitters: int = 2
    size: int = 64
    seed: int = 0
    shard_materials: int = 4

    def table(self) -> PictureTable:
        rows = np.arange(self.materials * 2 * self.jitters)
        material = rows // (2 * self.jitters)
        rng = np.random.default_rng(self.seed)
        shared, own = rng.normal(size=(self.materials, 1)), rng.normal(size=(self.materials, 7))
        logs = LOG_CENTRE + 0.8 * np.where(np.arange(7) >= 3, 0.8 * shared + 0.6 * own, own)
        return PictureTable(
            row=rows,
            shard=material // self.shard_materials,
            material=material,
            scene=(rows // self.jitters) % 2,
            parameters=np.exp(logs)[material],
            inclination_deg=np.zeros(len(rows)),
            jitter=rows % self.jitters,
        )

    def read(self, rows: NDArray[np.int64]) -> Tensor:
        table = self.table()
        y, x = np.meshgrid(np.linspace(-1, 1, self.size), np.linspace(-1, 1, self.size), indexing="ij")
        pictures = []
        for row in rows:
            logs = (np.log(table.parameters[row]) - LOG_CENTRE) / 0.8
            phase = np.random.default_rng(int(row)).uniform(0, 6)
            waves = 9.0 - 2.0 * logs[3:6].mean() + (2.0 if table.scene[row] else 0.0)
            height = 0.05 + 0.03 * np.sin(waves * (x + 0.2 * logs[0] * y) + phase) + 0.01 * logs[6] * y
            height[(np.abs(x) > 0.7) | (np.abs(y) > 0.7)] = 0.0
            pictures.append(np.rint(height / 1e-4).astype(np.int16))
        return torch.from_numpy(np.stack(pictures))
