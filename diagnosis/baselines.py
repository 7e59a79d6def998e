"""Simpler answers to the same question, to be beaten: an alarm that names nothing, templates, always the same."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from diagnosis.cause import NOT_EFFECTS
from diagnosis.diagnose import Diagnosis
from diagnosis.shrinkage import refitted_residual

Array = NDArray[np.float64]
BASELINES: Final = ("nearest_template", "least_residual", "most_flexible")
MMD_DRAWS = 200


def baseline_answers(found: Diagnosis) -> dict[str, Any]:
    """What simpler methods say of a set.

    Returns:
        ``names``: by method, the effect that it names; ``mmd_p``: p-value of the maximum mean discrepancy between the
        captures' residuals and draws of the noise model (Schmitt et al. 2021, as in sbi), which names nothing.
    """
    blocks = [b for b in found.blocks if b.scene == "stretch"] or list(found.blocks)
    measured = np.concatenate([b.stated.measured for b in blocks])
    cosine: dict[str, float] = {}
    left: dict[str, float] = {}
    for name in blocks[0].stated.responses:
        rows = np.concatenate([b.stated.responses[name] for b in blocks], axis=1)
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
        "mmd_p": _mmd_p([refitted_residual(b, np.zeros(len(b.stated.measured))) for b in blocks]),
    }


def _mmd_p(residuals: list[tuple[Array, Array]]) -> float:
    """Blocks' normalised residuals summarised by their quantiles, against as many drawn from the noise."""
    levels = np.linspace(0.05, 0.95, 10)
    seen = np.stack([np.quantile(left / np.sqrt(variance), levels) for left, variance in residuals])
    rng = np.random.default_rng(0)
    size = min(len(left) for left, _ in residuals)

    def draw(count: int) -> Array:
        return np.stack([np.quantile(rng.standard_normal(size), levels) for _ in range(count)])

    pool = draw(100)
    null = [_mmd(draw(len(seen)), pool) for _ in range(MMD_DRAWS)]
    value = _mmd(seen, pool)
    return float((1 + sum(n >= value for n in null)) / (1 + len(null)))


def _mmd(a: Array, b: Array) -> float:
    """Squared maximum mean discrepancy with a Gaussian kernel of unit width."""

    def kernel(x: Array, y: Array) -> float:
        return float(np.mean(np.exp(-0.5 * np.sum((x[:, None] - y[None]) ** 2, axis=2))))

    return kernel(a, a) + kernel(b, b) - 2 * kernel(a, b)
