"""Distance in the space of the seven parameters: what the drape distance is measured against."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simcore.errors import InputError
from simcore.parameters import FabricParameters
from simcore.prior import FabricPrior

_POPULATION = 512


@dataclass(frozen=True)
class ParameterDistance:
    """Euclidean distance between z-scores (paper, section 6.2).

    Attributes:
        centre: mean of the population, shape [7].
        spread: standard deviation of the population, shape [7].
        logarithmic: z-scores of the logarithms instead of the values.
    """

    centre: NDArray[np.float64]
    spread: NDArray[np.float64]
    logarithmic: bool = True

    @classmethod
    def of_population(cls, fabrics: Sequence[FabricParameters], *, logarithmic: bool = True) -> ParameterDistance:
        """z-scores against the given fabrics.

        Raises:
            InputError: fewer than two fabrics, or a parameter that does not vary.
        """
        if len(fabrics) < 2:
            raise InputError("z-scores need a population of at least two fabrics", code="population_too_small")
        values = np.stack([f.as_array() for f in fabrics])
        values = np.log(values) if logarithmic else values
        spread = values.std(axis=0)
        if (spread == 0).any():
            raise InputError("z-scores need a population in which every parameter varies", code="population_constant")
        return cls(values.mean(axis=0), spread, logarithmic)

    @classmethod
    def of_prior(cls, *, logarithmic: bool = True) -> ParameterDistance:
        """z-scores against the prior of real fabrics."""
        return cls.of_population(FabricPrior.default().sample(range(_POPULATION), seed=0), logarithmic=logarithmic)

    def scores(self, fabric: FabricParameters) -> NDArray[np.float64]:
        """z-scores, shape [7]."""
        values = fabric.as_array()
        scores: NDArray[np.float64] = ((np.log(values) if self.logarithmic else values) - self.centre) / self.spread
        return scores

    def matrix(self, fabrics: Sequence[FabricParameters]) -> NDArray[np.float64]:
        """Distance of every pair, shape [n, n]."""
        scores = np.stack([self.scores(f) for f in fabrics])
        matrix: NDArray[np.float64] = np.linalg.norm(scores[:, None] - scores[None, :], axis=2)
        return matrix
