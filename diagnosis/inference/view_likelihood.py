"""How probable the measurements of a fabric are once an explanation's response is taken away."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.inference.block import View
from diagnosis.inference.likelihood import LikelihoodModel

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Known:
    """What is needed to know of several blocks, each under one covariance, to take responses of any size away.

    Attributes:
        scenes: of the blocks, b.
        count: numbers of measurements, [b].
        whole: squared lengths of the whitened measurements, [b].
        log_det: half the log determinants of the covariances, [b].
        products: of whitened responses with one another, those at the nodes of what is tried, then those that were
            taken away before, [b, k + t, k + t].
        along: of these with the measurements, [b, k + t].
        tried: k.
    """

    scenes: tuple[str, ...]
    count: Array
    whole: Array
    log_det: Array
    products: Array
    along: Array
    tried: int

    @classmethod
    def of(cls, views: Sequence[View], rows: Sequence[Array], scenes: Sequence[str]) -> Known:
        """Of at least one block.

        Args:
            views: n measurements each; from all as many responses were taken away.
            rows: whitened responses at the nodes of what is tried, [k, n] each.
            scenes: of the blocks.
        """
        all_rows = [np.concatenate([own, *(r[None] for r in v.taken)]) for own, v in zip(rows, views, strict=True)]
        return cls(
            tuple(scenes),
            np.array([float(len(view.measured)) for view in views]),
            np.array([float(view.measured @ view.measured) for view in views]),
            np.array([view.log_det for view in views]),
            np.stack([own @ own.T for own in all_rows]),
            np.stack([own @ view.measured for own, view in zip(all_rows, views, strict=True)]),
            len(rows[0]),
        )

    def every(self, some: slice) -> Known:
        """Of some of the blocks."""
        return Known(
            self.scenes[some],
            self.count[some],
            self.whole[some],
            self.log_det[some],
            self.products[some],
            self.along[some],
            self.tried,
        )

    def at(self, rows: slice) -> Known:
        """Of some of the responses that are tried, with all that were taken away before."""
        kept = np.r_[np.arange(self.tried)[rows], self.tried : self.products.shape[1]]
        return Known(
            self.scenes,
            self.count,
            self.whole,
            self.log_det,
            self.products[:, kept[:, None], kept],
            self.along[:, kept],
            len(range(self.tried)[rows]),
        )

    def log_likelihood(self, weights: Array, model: LikelihoodModel) -> Array:
        """With the responses of many sizes taken away, [b, sizes].

        The response t is uncertain in its length and in its form: covariance I + share² t tᵀ (by Woodbury), and all
        errors grow with the response's mean square. What was taken away before is uncertain in the same way.

        Args:
            weights: of the responses at the nodes, [sizes, k].
            model: see there.
        """
        tried, size = self.tried, 1 + self.products.shape[1] - self.tried
        shape, count = (len(self.count), len(weights)), self.count[:, None]
        made = weights @ self.products[:, :tried]
        seen, gram = np.empty((*shape, size)), np.empty((*shape, size, size))
        seen[..., 0], seen[..., 1:] = self.along[:, :tried] @ weights.T, self.along[:, None, tried:]
        gram[..., 0, 0] = (made[..., :tried] * weights).sum(axis=2)
        gram[..., 0, 1:] = gram[..., 1:, 0] = made[..., tried:]
        gram[..., 1:, 1:] = self.products[:, None, tried:, tried:]
        lengths = Lengths.of(gram, seen - gram[..., 0], count, model, alone=size == 1)
        left = np.maximum(self.whole[:, None] - 2.0 * seen[..., 0] + gram[..., 0, 0], 0.0)
        dimension = count * model.dimension_share
        square = (left / lengths.grown - lengths.along) * model.dimension_share + lengths.square
        told = np.empty(shape)
        for scene in set(self.scenes):
            own = np.array([name == scene for name in self.scenes])
            told[own] = model.log_density(square[own], dimension[own], scene)
        spread = model.dimension_share * self.log_det[:, None]
        return np.asarray(told - (lengths.spent + 0.5 * dimension * np.log(lengths.grown) + spread))


def view_log_likelihood(view: View, rows: Array, weights: Array, scene: str, model: LikelihoodModel) -> Array:
    """Of one block with responses of many sizes taken away, [sizes]; see :class:`Known`."""
    return np.asarray(Known.of([view], [rows], [scene]).log_likelihood(weights, model)[0])


@dataclass(frozen=True)
class Lengths:
    """What the uncertain lengths of responses do to a likelihood; ``...``: blocks and sizes.

    Attributes:
        grown: by how much all errors' variance grows, since the responses' form is uncertain, [...].
        along: squared length of the residual in the span of the responses, in units of grown errors, as far as one
            alone is longer than the errors, [...].
        square: the same with the responses' lengths uncertain, [...].
        spent: half the log determinant of that, [...].
    """

    grown: Array
    along: Array
    square: Array
    spent: Array

    @classmethod
    def of(
        cls, gram: Array, cross: Array, count: Array | int, model: LikelihoodModel, *, alone: bool = True
    ) -> Lengths:
        """Of products of whitened responses with one another, [..., k, k], and with the residuals, [..., k], of
        ``count`` measurements.

        A direction in which the response to one effect alone is shorter than the errors is one among all others: what
        does not show is as probable as none. A second effect, which is sought longer, pays for it (decision 022).
        """
        grown = 1.0 + model.form_share**2 * np.trace(gram, axis1=-2, axis2=-1) / count
        own, parts = _directions(gram / grown[..., None, None], cross)
        own, parts = np.maximum(own, 0.0), parts / grown[..., None] ** 2
        least = 1e-10 * own.sum(axis=-1, keepdims=True) + 1e-12
        seen = own / (own + 1.0) if alone else 1.0
        along = (parts / (own + least) * seen).sum(axis=-1)
        told = (parts / (own + model.template_share**-2)).sum(axis=-1)
        spent = 0.5 * np.log1p(model.template_share**2 * own).sum(axis=-1)
        return cls(grown, along, along - told, spent)


def _directions(gram: Array, cross: Array) -> tuple[Array, Array]:
    """Eigenvalues of symmetric matrices, [..., k, k], and squares of vectors along their eigenvectors, [..., k].

    Of one or two directions, as nearly always, by formula: the library goes through the matrices one by one.
    """
    size = gram.shape[-1]
    if size == 1:
        return gram[..., 0], cross**2
    if size != 2:
        own, basis = np.linalg.eigh(gram)
        return own, (cross[..., None, :] @ basis)[..., 0, :] ** 2
    middle, half = 0.5 * (gram[..., 0, 0] + gram[..., 1, 1]), 0.5 * (gram[..., 0, 0] - gram[..., 1, 1])
    reach, turn = np.hypot(half, gram[..., 0, 1]), 0.5 * np.arctan2(gram[..., 0, 1], half)
    cosine, sine = np.cos(turn), np.sin(turn)
    small, large = cosine * cross[..., 1] - sine * cross[..., 0], cosine * cross[..., 0] + sine * cross[..., 1]
    return np.stack([middle - reach, middle + reach], axis=-1), np.stack([small, large], axis=-1) ** 2
