"""What an explanation leaves over that is common to all fabrics: the mark of something outside the catalogue.

What is in no catalogue cannot be simulated, but the change it brings can be put together from changes that can:
effects, parameters, pins, warps of the picture, smooth changes of any form, of the rim and of lines across the cloth,
in the same proportions for all fabrics. Such a mixture, of all of them or of one family, is fitted to all fabrics but
one and judged on the one left out; what is chance, or one fabric's own, predicts nothing, and of few changes less is
needed to be seen.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from diagnosis.inference.block import Block
from diagnosis.inference.changes import DESCRIBED, changes_of
from diagnosis.inference.likelihood import ALONE_NATS, LikelihoodModel

Array = NDArray[np.float64]
ALL = "all"
SINGLE = ("picture", "pins", "one pin", "rim", "lines", "weights", "one weight", "bends", "turns")
"""Families that are tried by themselves; smooth forms are not: another simulator shows one for no reason."""
ONE = {"one pin": ("pins", 2), "one weight": ("weights", 1)}
"""A family of which any one takes part, and not the others: each so many rows of another family."""
MIXED = ("effects", "parameters", "picture", "pins", "forms", "rim", "lines")
"""Families that take part in the mixture of all."""
BY_CHANCE_NATS = {
    ALL: 10.0,
    "picture": 3.0,
    "pins": 3.0,
    "one pin": 6.0,
    "rim": 6.0,
    "lines": 2.0,
    "weights": 3.0,
    "one weight": 2.0,
    "bends": 6.0,
    "turns": 0.0,
}
"""A mixture may gain so much where nothing unknown is there: simulators differ for no reason, each time otherwise; a
rim is lifted by curvatures of the catalogue, too, whose own responses may be of other folds; another simulator's set
without an effect shows bends worth 5.6, sets with nothing in them one pin worth 5.1 and one weight worth 0.6."""
SINGLE_SHARE = 0.5
"""Of mixtures: those of one family."""
WEIGHTS, SINGLE_WEIGHTS = (0.2, 0.4), (0.4, 1.0)
"""Spread of a mixture's proportions, 1 being what :mod:`diagnosis.inference.changes` says: smaller ones find how
simulators differ for no reason."""
ROUNDS = 6
LEAST_SQUARE = 0.3
"""A block that is fitted better than this share of its errors counts no more for it."""
NEAR_ENOUGH = 0.5
"""The same in the mixture of all: of another simulator's set without an effect three fabrics are at 0.4 of errors,
which how it differs from this one for no reason brings to 0.28. What is in no catalogue shows in one family, too."""


@dataclass(frozen=True)
class Mixture:
    """Changes of all fabrics, in units of their errors.

    Attributes:
        blocks: what was measured.
        columns: of each block, a row for each change, [k, n].
        grams: their products with each other, [k, k].
        families: of all changes together and of each of :data:`SINGLE`, the numbers of its rows.
        described: of a family, rows that effects of the catalogue describe: what they alone gain is nothing unknown.
        model: of the likelihood.
    """

    blocks: tuple[Block, ...]
    columns: tuple[Array, ...]
    grams: tuple[Array, ...]
    families: Mapping[str, NDArray[np.intp]]
    described: Mapping[str, NDArray[np.intp]]
    model: LikelihoodModel

    @classmethod
    def of(cls, effects: Sequence[str], blocks: Sequence[Block], model: LikelihoodModel) -> Mixture:
        """Of the catalogue's effects and what is not in it."""
        columns, rows = changes_of(effects, blocks)
        families = {ALL: np.concatenate([rows[name] for name in MIXED])}
        source = {name: ONE[name][0] if name in ONE else name for name in SINGLE}
        families |= {name: rows[own] for name, own in source.items() if len(rows[own])}
        known = {name: DESCRIBED[own] for name, own in source.items() if own in DESCRIBED and name in families}
        described = {name: rows[own] for name, own in known.items() if len(rows[own])}
        grams = tuple(c @ c.T for c in columns)
        return cls(tuple(blocks), tuple(columns), grams, families, described, model)

    def gain(self, left: Sequence[Array], granted: Sequence[Array] | None = None) -> Array:
        """Log likelihood of each fabric by a mixture fitted on the others, over that without; blocks as they count.

        Args:
            left: of each block, what an explanation leaves, whitened, [n].
            granted: of each block, changes that count for nothing, [rows, n]: how the explanation itself would change
                with its size, which may be fitted too small or too large.

        Returns:
            For each of the families, the best of its weights, without what changes gain that the catalogue describes;
            nothing (-inf) for a single fabric.
        """
        fabrics = sorted({block.fabric for block in self.blocks})
        if len(fabrics) < 2:
            return np.full(len(self.families), -np.inf)
        if granted is not None:
            bases = [_basis(rows) for rows in granted]
            beyond = [own - basis @ (basis.T @ own) for own, basis in zip(left, bases, strict=True)]
            return self._beyond(bases).gain(beyond)
        products = [rows @ own for rows, own in zip(self.columns, left, strict=True)]

        def most(name: str, rows: NDArray[np.intp]) -> float:
            weights, least = (WEIGHTS, NEAR_ENOUGH) if name == ALL else (SINGLE_WEIGHTS, 0.0)
            return max(self._gain(left, products, rows, fabrics, weight, least) for weight in weights)

        def any_one(name: str, rows: NDArray[np.intp]) -> float:
            size = ONE[name][1] if name in ONE else len(rows)
            found = [most(name, own) for own in np.split(rows, range(size, len(rows), size))]
            return float(logsumexp(found)) - float(np.log(len(found)))

        known = {name: max(0.0, most(name, rows)) for name, rows in self.described.items()}
        return np.array([any_one(name, rows) - known.get(name, 0.0) for name, rows in self.families.items()])

    def shows_in_pictures(self, gains: Array) -> bool:
        """Warps of the pictures that are the same for all fabrics gain more than by chance; gains by family."""
        return float(gains[list(self.families).index("picture")]) > BY_CHANCE_NATS["picture"]

    def evidence(self, gains: Array, *, beside: float | None = None, exact: bool = False) -> float:
        """Log evidence of a mixture, whichever family it is of, over that without.

        Args:
            gains: by family.
            beside: so much of each may be there beside an effect; None: without one, what chance gives.
            exact: the effect's own warp of the pictures is known exactly: of these no more than by chance is there.
        """
        single = np.array([name != ALL for name in self.families])
        share = np.where(single, SINGLE_SHARE / single.sum(), 1.0 - SINGLE_SHARE)
        chance = np.array([BY_CHANCE_NATS[name] for name in self.families])
        plain = np.array([beside is None or (exact and name == "picture") for name in self.families])
        return float(logsumexp(gains - np.where(plain, chance, beside or 0.0), b=share))

    def _beyond(self, bases: Sequence[Array]) -> Mixture:
        """Without what each block's orthonormal columns span."""
        along = [rows @ basis for rows, basis in zip(self.columns, bases, strict=True)]
        columns = [r - a @ b.T for r, a, b in zip(self.columns, along, bases, strict=True)]
        grams = [gram - a @ a.T for gram, a in zip(self.grams, along, strict=True)]
        return replace(self, columns=tuple(columns), grams=tuple(grams))

    def _gain(
        self,
        left: Sequence[Array],
        products: Sequence[Array],
        rows: NDArray[np.intp],
        fabrics: Sequence[str],
        weight: float,
        least: float,
    ) -> float:
        """Of a mixture of some rows whose proportions are spread by a weight; nearer than ``least`` counts as that."""
        products, grams = [p[rows] for p in products], [g[np.ix_(rows, rows)] for g in self.grams]
        squares = [float(own @ own) for own in left]
        count = [len(own) for own in left]

        def remaining(share: Array, n: int) -> float:
            return max(0.0, squares[n] - 2 * float(share @ products[n]) + float(share @ grams[n] @ share))

        gains = []
        for fabric in fabrics:
            seen = [n for n, block in enumerate(self.blocks) if block.fabric != fabric]
            share = np.zeros(len(rows), dtype=np.float64)
            for _ in range(ROUNDS):
                precision = np.eye(len(share)) / weight**2
                right = np.zeros(len(share))
                for n in seen:
                    heard = self.model.dimension_share / max(remaining(share, n) / count[n], LEAST_SQUARE)
                    precision += heard * grams[n]
                    right += heard * products[n]
                share = np.asarray(np.linalg.solve(precision, right), dtype=np.float64)
            held = [n for n, block in enumerate(self.blocks) if block.fabric == fabric]
            gains.append(sum(self._counted(remaining(share, n), squares[n], n, count[n], least) for n in held))
        gains.sort()
        return float(sum(gains) - max(0.0, gains[-1] - max(gains[-2], 0.0) - ALONE_NATS))

    def _counted(self, after: float, before: float, number: int, count: int, least: float) -> float:
        """Gain of one block from its squared residual after and before; the least mean square that tells."""
        share, scene = self.model.dimension_share, self.blocks[number].scene
        told = np.maximum([after, before], least * count)
        now, then = self.model.log_density(told * share, count * share, scene)
        return float(self.model.counted(now - then, scene))


def _basis(rows: Array) -> Array:
    """Orthonormal columns that span the rows, [n, rank]."""
    _, size, basis = np.linalg.svd(rows, full_matrices=False)
    return np.asarray(basis[size > 1e-9 * max(float(size.max(initial=0.0)), 1e-9)].T)
