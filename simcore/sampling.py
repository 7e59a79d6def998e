"""Points of the unit cube that a sweep visits, each addressable by its index alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from simcore.errors import InputError

DIMENSIONS = 7
MAX_INDEX = 2**30
"""Points of one Sobol sequence (scipy's 30-bit generator)."""

SOBOL_ATTEMPTS = 8
"""Sobol sequences that an index tries; narrow ranges go on with independent points, which need no table to be kept."""


class DesignKind(StrEnum):
    """How a sweep chooses its fabrics."""

    SOBOL = "sobol"
    RANDOM = "random"
    GRID = "grid"
    LIST = "list"

    @classmethod
    def parse(cls, name: str) -> DesignKind:
        """Design by name.

        Raises:
            InputError: unknown name.
        """
        try:
            return cls(name)
        except ValueError:
            choices = ", ".join(kind.value for kind in cls)
            raise InputError(f"unknown design {name!r}: choose one of {choices}", code="design_unknown") from None

    @property
    def draws(self) -> bool:
        """Whether the fabrics are drawn from the prior; those of a grid or list are known one by one."""
        return self in (DesignKind.SOBOL, DesignKind.RANDOM)


class UnitDesign(Protocol):
    """Points in the unit cube.

    ``attempt`` counts the proposals for one index: a point that falls outside the admissible fabrics is replaced by the
    same index of another, independent sequence, so that an index never depends on its neighbours' luck.
    """

    def points(self, indices: NDArray[np.int64], attempt: int) -> NDArray[np.float64]:
        """Points of the given indices, float64, shape [len(indices), 7], in the open interval (0, 1)."""
        ...


@dataclass
class SobolDesign:
    """Scrambled Sobol points (scipy's: linear matrix scramble and digital shift, Matousek 1998).

    A point depends on ``seed``, ``attempt`` and its index alone. The generator is kept and runs forward, so a walk
    through rising indices costs nothing and a leap of 10^8 points about 0.3 s.

    Attributes:
        seed: seed of the scrambling.
    """

    seed: int
    _engines: dict[int, Any] = field(default_factory=dict, repr=False)

    def __getstate__(self) -> dict[str, Any]:
        """The seed alone: generators' tables that came through shared memory could not be written to."""
        return {"seed": self.seed, "_engines": {}}

    def _engine(self, attempt: int) -> Any:
        if attempt not in self._engines:
            rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(attempt,)))
            self._engines[attempt] = qmc.Sobol(DIMENSIONS, scramble=True, rng=rng)
        return self._engines[attempt]

    def points(self, indices: NDArray[np.int64], attempt: int) -> NDArray[np.float64]:
        """See :class:`UnitDesign`."""
        _check_indices(indices, MAX_INDEX)
        if attempt >= SOBOL_ATTEMPTS:
            return RandomDesign(self.seed).points(indices, attempt)
        engine = self._engine(attempt)
        result = np.empty((len(indices), DIMENSIONS))
        order = np.argsort(indices, kind="stable")
        start = 0
        while start < len(order):
            stop = start + 1  # a run of consecutive indices is drawn at once
            while stop < len(order) and indices[order[stop]] == indices[order[stop - 1]] + 1:
                stop += 1
            first = int(indices[order[start]])
            if engine.num_generated > first:
                engine.reset()
            if engine.num_generated < first:
                engine.fast_forward(first - engine.num_generated)
            if first == 0:  # scipy warns of a first draw that is no power of two: the sweep's length is the user's
                result[order[start]] = engine.random(1)[0]
                start += 1
            if start < stop:
                result[order[start:stop]] = engine.random(stop - start)
            start = stop
        return _open_interval(result)


@dataclass(frozen=True)
class RandomDesign:
    """Independent uniform points, one counter-based stream an index.

    Attributes:
        seed: seed of the streams.
    """

    seed: int

    def points(self, indices: NDArray[np.int64], attempt: int) -> NDArray[np.float64]:
        """See :class:`UnitDesign`."""
        _check_indices(indices, 2**63 - 1)
        rows = [
            np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(attempt, int(index)))).random(DIMENSIONS)
            for index in indices
        ]
        return _open_interval(np.array(rows).reshape(-1, DIMENSIONS))


def _check_indices(indices: Sequence[int] | NDArray[np.int64], end: int) -> None:
    if len(indices) and not (int(np.min(indices)) >= 0 and int(np.max(indices)) < end):
        raise InputError(f"sample index outside 0 to {end - 1} of this design", code="index_out_of_range")


def _open_interval(points: NDArray[np.float64]) -> NDArray[np.float64]:
    tiny = 2.0**-32
    return np.clip(points, tiny, 1.0 - tiny)
