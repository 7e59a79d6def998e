"""Standard error of a mean over all pairs of two samples of renders."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray


def mean_and_error(table: NDArray[np.float64]) -> tuple[float, float | None]:
    """Mean of IM(a_i, b_j) over all pairs and its standard error.

    The N x M entries are not independent: the N renders of one fabric and the M of the other are. With
    IM_ij = d + r_i + c_j + e_ij (random row, column and interaction), Var(mean) = Var(r)/N + Var(c)/M + Var(e)/(NM),
    estimated without bias from the variance of row means s_r², of column means s_c² and the residual mean square s_e²:
    s_r²/N + s_c²/M - s_e²/(NM), never taken below s_e²/(NM).

    Args:
        table: IM of every pair, shape [N, M].

    Returns:
        Mean, and standard error or None where N or M is 1.
    """
    means, errors = means_and_errors(table[None].astype(np.float64))
    return float(means[0]), None if math.isnan(errors[0]) else float(errors[0])


def means_and_errors(tables: NDArray[np.floating]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """:func:`mean_and_error` of many tables at once.

    Args:
        tables: shape [n, N, M].

    Returns:
        Means and standard errors, each shape [n]; NaN errors where N or M is 1.
    """
    _, rows, columns = tables.shape
    row_means, column_means = tables.mean(axis=2, dtype=np.float64), tables.mean(axis=1, dtype=np.float64)
    means = row_means.mean(axis=1)
    if rows < 2 or columns < 2:
        return means, np.full(len(tables), np.nan)
    residual = tables - row_means[:, :, None] - column_means[:, None, :] + means[:, None, None]
    interaction = np.sum(residual**2, axis=(1, 2)) / ((rows - 1) * (columns - 1)) / (rows * columns)
    variance = row_means.var(axis=1, ddof=1) / rows + column_means.var(axis=1, ddof=1) / columns - interaction
    return means, np.sqrt(np.maximum(variance, interaction))


def self_mean_and_error(table: NDArray[np.float64]) -> tuple[float, float | None]:
    """The same for one fabric against itself: mean over i != j, so that no render is compared with itself.

    The variance is the leave-one-out jackknife over renders of this U-statistic (Efron and Stein 1981).

    Args:
        table: IM of every pair of one sample, symmetric, shape [N, N], N >= 2.

    Returns:
        Mean, and standard error or None where N is below 3.
    """
    count = table.shape[0]
    sums = table.sum(axis=1) - np.diag(table)
    total = float(sums.sum())
    mean = total / (count * (count - 1))
    if count < 3:
        return mean, None
    left_out = (total - 2.0 * sums) / ((count - 1) * (count - 2))
    variance = (count - 1) / count * float(np.sum((left_out - left_out.mean()) ** 2))
    return mean, math.sqrt(variance)
