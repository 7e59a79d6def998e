"""TensorBoard, for those who ask for it; nothing is tracked otherwise."""

from __future__ import annotations

import os
import socket
import time
import warnings
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from trainer.evaluate import Metrics
    from trainer.train import Progress


class TensorBoardLog:
    """Writes progress and final scores as TensorBoard events; a training that cannot begin leaves no folder.

    A folder that cannot be written to costs the events, never the training: it is told of once.

    Args:
        folder: of the event files.
        then: also called with every progress.
        tell: called with the one line that says why there are no more events.
    """

    def __init__(
        self,
        folder: str | Path,
        then: Callable[[Progress], None] | None = None,
        tell: Callable[[str], None] = warnings.warn,
    ) -> None:
        self._folder, self._then, self._tell = Path(folder), then, tell
        self._file: _EventFile | None = None
        self._ended = False
        self._step = 0

    def __enter__(self) -> TensorBoardLog:
        return self

    def __exit__(self, *_: object) -> None:
        """Close, also when interrupted."""
        self.close()

    def report(self, progress: Progress) -> None:
        """One step, written once: ranks are asked how far they are more often than they step."""
        if progress.step != self._step:
            self._step = progress.step
            self._write({"train/squared_error": progress.loss})
        if self._then is not None:
            self._then(progress)

    def finish(self, metrics: Metrics) -> None:
        """The scores on the test materials, at the last step; the last word."""
        values = {}
        for predictor, rows in metrics.scores.items():
            for name, score in rows.items():
                values[f"mae_log/{name}/{predictor}"] = score.mae_log
                values[f"spearman/{name}/{predictor}"] = score.spearman
        self._write(values)
        self.close()

    def close(self) -> None:
        """No event is written after this; twice does nothing."""
        if self._ended:
            return
        self._ended = True
        try:
            if self._file is not None:
                self._file.close()
        except OSError as error:
            self._give_up(error)

    def _write(self, values: Mapping[str, float]) -> None:
        if self._ended:
            return
        try:
            if self._file is None:
                self._file = _EventFile(self._folder)
            self._file.write(values, self._step)
        except OSError as error:
            self._give_up(error)

    def _give_up(self, error: OSError) -> None:
        self._ended = True
        if self._file is not None:
            with suppress(OSError):  # what it still holds cannot be written either
                self._file.close()
        self._tell(
            f"{self._folder}: TensorBoard events cannot be written ({error.strerror or error}): the training goes on "
            "without them"
        )


class _EventFile:
    """One event file, made at once and written through with every event.

    PyTorch's writer writes in a thread, which prints a traceback where it fails and is heard of events later.
    """

    def __init__(self, folder: Path) -> None:
        from tensorboard.summary.writer.record_writer import RecordWriter

        folder.mkdir(parents=True, exist_ok=True)
        name = f"events.out.tfevents.{int(time.time()):010d}.{socket.gethostname()}.{os.getpid()}"
        self._records = RecordWriter((folder / name).open("wb"))
        self._add(file_version="brain.Event:2")

    def write(self, values: Mapping[str, float], step: int) -> None:
        """Scalars by tag, at a step."""
        from tensorboard.compat.proto.summary_pb2 import Summary

        summary = Summary(value=[Summary.Value(tag=tag, simple_value=value) for tag, value in values.items()])
        self._add(summary=summary, step=step)

    def close(self) -> None:
        """Nothing is written after this."""
        self._records.close()

    def _add(self, **fields: object) -> None:
        from tensorboard.compat.proto.event_pb2 import Event

        self._records.write(Event(wall_time=time.time(), **fields).SerializeToString())
        self._records.flush()
