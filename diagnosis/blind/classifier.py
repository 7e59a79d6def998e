"""A plain classifier on residuals, trained on cases assembled from the responses of other seeds: a baseline.

It sees what the diagnosis sees, averaged over the fabrics of a set: difference in each cell of the cloth and the
numbers that a set shares. No refit of parameters, no noise model but in its examples.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from diagnosis.effect import Effect
from diagnosis.effects import get_effect
from diagnosis.inference.block import Block, PixelBlock
from diagnosis.measurement.reference import cell_centres
from diagnosis.simulation.sizes import node_weights

Array = NDArray[np.float64]
UNIT_M = 0.001
NOISE_DRAWS = 30
EXAMPLES = 40
"""Of each effect, for each case that gives its responses."""
TREES = 200


def features(blocks: Sequence[Block], pixels: PixelBlock) -> Array:
    """Of a set, [cells + ring + numbers]."""
    return _joined([_by_cell(b, b.metres(b.stated.measured)) for b in blocks], pixels.measured)


def example_parts(blocks: Sequence[Block], pixels: PixelBlock) -> dict[str, Array]:
    """What training cases are assembled from: the responses of every effect at its nodes, and draws of the noise."""
    parts = {}
    for name, rows in pixels.responses.items():
        if get_effect(name).random_repeats:
            continue
        nodes = range(len(rows))
        parts[name] = np.stack(
            [_joined([_by_cell(b, b.metres(b.stated.responses[name][n])) for b in blocks], rows[n]) for n in nodes]
        )
    rng = np.random.default_rng(0)
    noise = []
    for _ in range(NOISE_DRAWS):
        draws = [_by_cell(b, b.metres(rng.standard_normal(len(b.owner)))) for b in blocks]
        noise.append(_joined(draws, rng.standard_normal(len(pixels.measured))))
    parts["noise"] = np.stack(noise)
    return parts


def _joined(cells: Sequence[Array], numbers: Array) -> Array:
    mean = np.nan_to_num(np.nanmean(np.stack(cells), axis=0)) / UNIT_M
    return np.concatenate([mean, numbers])


def _by_cell(block: Block, values: Array) -> Array:
    """Mean over repeats in each cell, NaN where none is seen, [cells + ring]."""
    count = len(cell_centres())
    seen = np.bincount(block.cell, minlength=count)
    total = np.bincount(block.cell, values, minlength=count)
    return np.asarray(np.where(seen > 0, total / np.maximum(seen, 1), np.nan))


def known_as_tried(parts: Mapping[str, Array], effects: Sequence[str]) -> frozenset[str]:
    """Effects that :func:`example_parts` are of, as they are tried now: at as many sizes and places."""

    def alike(effect: Effect) -> bool:
        rows = parts.get(effect.name)
        return rows is not None and len(rows) == len(node_weights(effect, effect.typical()))

    return frozenset(name for name in effects if alike(get_effect(name)))


@dataclass(frozen=True)
class Classifier:
    """A random forest over the catalogue.

    Attributes:
        names: of the classes.
        forest: fitted.
    """

    names: tuple[str, ...]
    forest: Any

    @classmethod
    def train(cls, parts: Sequence[Mapping[str, Array]], effects: Sequence[str], seed: int = 0) -> Classifier:
        """Assemble cases of random size from other sets' responses and noise, and fit.

        Args:
            parts: of :func:`example_parts`.
            effects: the classes.
            seed: of sizes, noise and forest.
        """
        from sklearn.ensemble import RandomForestClassifier

        rng = np.random.default_rng(seed)
        names = tuple(name for name in effects if name in parts[0])
        rows, labels = [], []
        for one in parts:
            for label, name in enumerate(names):
                effect = get_effect(name)
                for _ in range(EXAMPLES):
                    noise = one["noise"][rng.integers(len(one["noise"]))]
                    rows.append(node_weights(effect, effect.draw(rng, listed=True)) @ one[name] + noise)
                    labels.append(label)
        forest = RandomForestClassifier(TREES, random_state=seed, n_jobs=1)
        return cls(names, forest.fit(np.stack(rows), labels))

    def effect(self, values: Array) -> str:
        """The likeliest effect of a set."""
        return self.names[int(self.forest.predict(values[None])[0])]
