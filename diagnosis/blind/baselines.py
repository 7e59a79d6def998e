"""Simpler answers to the same question, to be beaten: an alarm that names nothing, templates, always the same."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from diagnosis.diagnose import Diagnosis
from diagnosis.groups import NOT_EFFECTS
from diagnosis.inference.block import Block, whiten
from diagnosis.inference.likelihood import LikelihoodModel

Array = NDArray[np.float64]
BASELINES: Final = ("nearest_template", "least_residual", "most_flexible")
MMD_DRAWS = 200
POOL_DRAWS = 100
"""Draws of the noise, over all blocks together, that a set is held against."""
LEVELS: Final = np.linspace(0.05, 0.95, 10)
"""Quantiles that sum up a block's residuals."""


def baseline_answers(found: Diagnosis) -> dict[str, Any]:
    """What simpler methods say of a set.

    The most flexible effect is bending hysteresis, whose draws give the most directions; where it is not tried, the
    effect that explains most at its best size.

    Returns:
        ``names``: by method, the effect that it names; ``mmd_p``: see :func:`mmd_p`, which names nothing.
    """
    blocks = [b for b in found.blocks if b.scene == "stretch"] or list(found.blocks)
    shape = np.concatenate([b.stated.measured for b in blocks])
    measured = np.concatenate([shape, found.pixels.measured])  # both in units of their errors
    cosine: dict[str, float] = {}
    left: dict[str, float] = {}
    for name in blocks[0].stated.responses:
        on_cloth = np.concatenate([b.stated.responses[name] for b in blocks], axis=1)
        rows = np.concatenate([on_cloth, found.pixels.responses[name]], axis=1)
        length = np.linalg.norm(rows, axis=1) + 1e-12
        share = rows @ measured / length
        cosine[name] = float(np.max(share / np.linalg.norm(measured)))
        left[name] = float(np.min(np.sum((measured - rows) ** 2, axis=1)))
    gains = {n: e.best for n, e in found.cause.evidence.items() if n not in NOT_EFFECTS}
    return {
        "names": {
            "nearest_template": max(cosine, key=lambda n: cosine[n]),
            "least_residual": min(left, key=lambda n: left[n]),
            "most_flexible": "bending_hysteresis"
            if "bending_hysteresis" in gains
            else max(gains, key=lambda n: gains[n]),
        },
        "mmd_p": mmd_p(blocks),
    }


def mmd_p(blocks: Sequence[Block]) -> float:
    """P-value of the maximum mean discrepancy between residuals and drawn noise (Schmitt et al. 2021, as in sbi).

    Every block is summed up by the quantiles of its normalised residuals, parameters refitted. What it is held against
    are errors drawn from the block's own stated covariance, of one unknown scale a block as the diagnosis grants it
    (:class:`diagnosis.inference.likelihood.LikelihoodModel`), refitted and summed up in the same way: neighbouring
    cells err together, so their quantiles wander far more than those of as many independent numbers. The kernel is as
    wide as the median distance between draws.
    """
    rng = np.random.default_rng(0)
    maps = [refitted_map(block) for block in blocks]
    seen = np.stack([_summary(m, b.stated.measured[:, None])[0] for m, b in zip(maps, blocks, strict=True)])
    count = MMD_DRAWS + -(-POOL_DRAWS // len(blocks))
    drawn = np.stack([_summary(m, draw_noise(b, count, rng)) for m, b in zip(maps, blocks, strict=True)])
    pool = np.concatenate(drawn[:, MMD_DRAWS:])
    width = float(np.sqrt(np.median(_squares(pool, pool)[~np.eye(len(pool), dtype=bool)])))
    null = [_mmd(drawn[:, number], pool, width) for number in range(MMD_DRAWS)]
    value = _mmd(seen, pool, width)
    return float((1 + sum(n >= value for n in null)) / (1 + len(null)))


def draw_noise(block: Block, count: int, rng: np.random.Generator) -> Array:
    """Whitened measurements of a block in which there are errors alone, [n, count]."""
    model = LikelihoodModel()
    spread = model.spread_hanging if block.scene == "hanging" else model.spread_stretch
    scale = np.exp(spread * rng.standard_normal(count))
    return scale * rng.standard_normal((len(block.stated.measured), count))


def refitted_map(block: Block) -> Array:
    """From a block's whitened measurements to what a refit of the parameters leaves of them [m], [n, n].

    The same as :func:`diagnosis.shrinkage.held_out.refit` for many measurements at once: ``L - Jᵀ (L⁻¹ Jᵀ)ᵀ``.
    """
    columns = block.jacobian.T
    return np.asarray(block.stated.factor - columns @ whiten(block.stated, columns).T)


def _summary(refitted: Array, whitened: Array) -> Array:
    """Quantiles of normalised residuals, [draws, levels], of whitened measurements [n, draws]."""
    expected = np.sqrt(np.sum(refitted**2, axis=1))
    return np.asarray(np.quantile((refitted @ whitened) / expected[:, None], LEVELS, axis=0).T)


def _mmd(a: Array, b: Array, width: float) -> float:
    """Squared maximum mean discrepancy with a Gaussian kernel, but for what is the same for all that ``b`` judges."""
    return float(np.mean(_kernel(a, a, width)) - 2.0 * np.mean(_kernel(a, b, width)))


def _kernel(x: Array, y: Array, width: float) -> Array:
    return np.asarray(np.exp(-0.5 * _squares(x, y) / width**2))


def _squares(x: Array, y: Array) -> Array:
    """Squared distances of rows, [x, y]."""
    return np.asarray(np.sum((x[:, None] - y[None]) ** 2, axis=2))
