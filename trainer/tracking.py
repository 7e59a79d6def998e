"""TensorBoard, for those who ask for it; nothing is tracked otherwise."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any

from trainer.evaluate import Metrics
from trainer.train import Progress


class TensorBoardLog:
    """Writes progress and final scores as TensorBoard events; a training that cannot begin leaves no folder.

    Args:
        folder: of the event files.
        then: also called with every progress.
    """

    def __init__(self, folder: str | Path, then: Callable[[Progress], None] | None = None) -> None:
        from torch.utils import tensorboard

        self._make_writer: Any = tensorboard.SummaryWriter  # torch does not annotate it
        self._folder = str(folder)
        self._then = then
        self._step = 0

    @cached_property
    def _writer(self) -> Any:
        return self._make_writer(self._folder)

    def report(self, progress: Progress) -> None:
        """One step."""
        self._step = progress.step
        self._writer.add_scalar("train/squared_error", progress.loss, progress.step)
        if self._then is not None:
            self._then(progress)

    def finish(self, metrics: Metrics) -> None:
        """The scores on the test materials, at the last step; the last word."""
        for predictor, rows in metrics.scores.items():
            for name, score in rows.items():
                self._writer.add_scalar(f"mae_log/{name}/{predictor}", score.mae_log, self._step)
                self._writer.add_scalar(f"spearman/{name}/{predictor}", score.spearman, self._step)
        self._writer.close()
