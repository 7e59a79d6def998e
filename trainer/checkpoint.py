"""A training on its way, kept beside the model's place, so that one that is interrupted can go on.

The file is what ``torch.save`` writes of tensors and plain values, with a line behind it that says the format and the
hash of what is before it. It is read with ``weights_only``: nothing in it is executed.
"""

from __future__ import annotations

import hashlib
import io
import os
import pickle
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from renderer.atomic import write_atomically
from simcore.errors import DrapemeterError, InputError
from trainer.dataset import Batch

FORMAT = "drapemeter-checkpoint/1"
STEPS_BETWEEN = 100
"""So many steps are lost at most; writing the file takes less than a hundredth of their time."""
_UNREADABLE = (OSError, EOFError, RuntimeError, ValueError, KeyError, TypeError, pickle.UnpicklingError)


def checkpoint_place(out: Path) -> Path:
    """The file beside a model folder that is to be written; beside what a link names, as the model is."""
    model = Path(os.path.realpath(out))
    return model.with_name(f"{model.name}.checkpoint")


def is_due(step: int, steps: int) -> bool:
    """Whether to keep the state behind a step: now and then, and at the end, as calibration may be interrupted, too."""
    return step % STEPS_BETWEEN == 0 or step == steps


@dataclass(frozen=True)
class Checkpoint:
    """All that a training goes on from; what else it draws at random follows from its seed and the step.

    Attributes:
        step: optimiser steps done.
        recent: the loss over the recent steps.
        network: weights and statistics.
        optimiser, schedule: state dictionaries of both.
        generator: torch's global generator, which dropout draws from; uint8, shape [bytes].
    """

    step: int
    recent: float
    network: dict[str, Tensor]
    optimiser: dict[str, Any]
    schedule: dict[str, Any]
    generator: Tensor

    @classmethod
    def of(
        cls,
        step: int,
        recent: float,
        network: nn.Module,
        optimiser: torch.optim.Optimizer,
        schedule: torch.optim.lr_scheduler.LRScheduler,
    ) -> Checkpoint:
        """Of a training behind a step; shares its tensors, so write it before the next."""
        states = network.state_dict(), optimiser.state_dict(), schedule.state_dict()
        return cls(step, recent, *states, torch.random.get_rng_state())

    def restore(
        self,
        network: nn.Module,
        optimiser: torch.optim.Optimizer,
        schedule: torch.optim.lr_scheduler.LRScheduler,
    ) -> None:
        """Put all but the generator's state back, in place."""
        network.load_state_dict(self.network)
        optimiser.load_state_dict(self.optimiser)
        schedule.load_state_dict(self.schedule)

    def with_generator(self, pairs: Iterable[Batch]) -> Iterator[Batch]:
        """The batches, with the generator's state back behind the first: a loader draws from it as it begins."""
        for number, batch in enumerate(pairs):
            if number == 0:
                torch.random.set_rng_state(self.generator)
            yield batch


@dataclass
class CheckpointFile:
    """Where one training is kept. What cannot be written (a full disk) is told of once and ends no training.

    Attributes:
        path: the file.
        resume: go on from it.
        tell: called with lines about it.
        step: of the last state that is safe there; 0 = none of this training.
    """

    path: Path
    resume: bool
    tell: Callable[[str], None]
    step: int = field(default=0, init=False)
    _told: bool = field(default=False, init=False)

    def check(self) -> None:
        """Refuse to overwrite an unfinished training, and to go on from none.

        Raises:
            InputError: a file is there and was not asked for, or is asked for and not there.
        """
        there = os.path.lexists(self.path)
        if there and not self.resume:
            raise InputError(
                f"{self.path} is of a training that was not finished, or still runs: give --resume to go on with it, "
                "or remove the file to train anew",
                code="training_unfinished",
            )
        if self.resume and not there:
            raise InputError(
                f"{self.path} is not there, nothing to go on from: leave out --resume, or name the --out of the "
                "training that was interrupted",
                code="checkpoint_missing",
            )

    def read(self, run: Mapping[str, str]) -> Checkpoint | None:
        """What to go on from; None where that was not asked for.

        Args:
            run: what the training to go on with is of (:func:`trainer.same_run.description`).

        Raises:
            InputError: the file cannot be read, or is of another training.
        """
        if not self.resume:
            return None
        stored = self._content()
        _check_same(self.path, stored["run"], run)
        self.step = stored["state"]["step"]
        self.tell(f"{self.path}: the training goes on behind step {self.step}")
        return Checkpoint(**stored["state"])

    def write(self, run: Mapping[str, str], state: Checkpoint) -> None:
        """Keep a state in the place of an earlier one."""
        content = io.BytesIO()
        plain = {one.name: getattr(state, one.name) for one in fields(state)}
        torch.save({"run": dict(run), "state": plain}, content)
        with content.getbuffer() as written:
            seal = _seal(written)
        content.write(seal)
        try:
            write_atomically(self.path, content.getvalue())
        except DrapemeterError as error:
            if not self._told:
                self._told = True
                place = f"behind step {self.step}" if self.step else "at the beginning"
                self.tell(f"{error}: the training goes on; interrupted by now, it would have to go on {place}")
            return
        self.step = state.step

    def remove(self) -> None:
        """Take it away behind a training that is finished."""
        self.step = 0
        try:
            self.path.unlink(missing_ok=True)
        except OSError as error:
            self.tell(f"{self.path}: cannot be removed ({error.strerror}): the training is finished, remove it")

    def _content(self) -> dict[str, Any]:
        try:
            content, _, stated = self.path.read_bytes().rpartition(b"\n")
            if b"\n" + stated != _seal(content):
                raise ValueError(f"cut short, damaged, or not of the format {FORMAT}")
            stored: dict[str, Any] = torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
        except _UNREADABLE as error:
            why = error.strerror if isinstance(error, OSError) else (str(error).splitlines() or ["damaged"])[0]
            raise InputError(
                f"{self.path}: cannot be read as a checkpoint ({why}): remove it to train anew",
                code="checkpoint_damaged",
            ) from None
        return stored


def _seal(content: bytes | memoryview) -> bytes:
    """The last line of a file with this content."""
    return f"\n{FORMAT} {hashlib.sha256(content).hexdigest()}".encode()


def _check_same(path: Path, then: Mapping[str, str], now: Mapping[str, str]) -> None:
    """Refuse a checkpoint of another training.

    Raises:
        InputError: it is; the message names what differs.
    """
    names = [name for name in {**then, **now} if then.get(name) != now.get(name)]
    if names:
        differing = ", ".join(f"{name} (then {then.get(name, '-')}, now {now.get(name, '-')})" for name in names)
        raise InputError(
            f"{path} is of another training: {differing}; resume with the options, stores and versions of then, or "
            "remove it to train anew",
            code="checkpoint_of_another_run",
        )
