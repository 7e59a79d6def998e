"""A vector's fit held against the range that its length has beforehand."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp
from scipy.stats import norm, qmc

from diagnosis.effect import Effect
from diagnosis.simulation.sizes import fading

Array = NDArray[np.float64]
LENGTHS = 64
"""So many lengths are tried between the fitted one and the range."""
POINTS = 512
"""At so many points around each of two sizes the prior's fall outside the range is integrated."""
FAR = 6.0
"""So many standard deviations inside its range a fit does not feel the range's ends."""
_HALVINGS = 60
_LEAST = 1e-9


def into_range(effect: Effect, size: Array, hessian: Array) -> tuple[Array, float]:
    """The most probable size, and what the range makes of a fit's evidence.

    Likelihood and Gaussian prior together are a Gaussian around the fit; beyond its range the prior falls on top of
    that (:func:`diagnosis.simulation.sizes.fading`). What these captures hardly show may have any size: the one that
    fits best, zero, is then no reason against it.

    Args:
        effect: whose components were fitted.
        size: where likelihood and Gaussian prior are greatest, [components].
        hessian: of their logarithm there, its sign turned.

    Returns:
        The size where all three are greatest; it is ``size`` where that lies in the range. Log of the mean of the
        fall over the Gaussian, by importance sampling around both sizes at fixed points.
    """
    component = next(iter(effect.components.values()))
    length = float(np.linalg.norm(size))
    best = size
    wide = FAR / float(np.sqrt(np.linalg.eigvalsh(hessian)[0]))
    if component.low + wide < length < component.high - wide:
        return size, 0.0
    if not component.low <= length <= component.high:
        end = component.low if length < component.low else component.high
        lengths = np.geomspace(max(length, _LEAST * end), end, LENGTHS)[1:]
        tried = at_lengths(size, hessian, lengths)
        away = tried - size
        worth = -0.5 * np.einsum("ni,ij,nj->n", away, hessian, away)
        worth += fading(component, lengths)
        best = tried[int(np.argmax(worth))]
    root = np.linalg.inv(np.linalg.cholesky(hessian)).T
    around = _normal_points(len(size)) @ root.T
    points = np.concatenate([size + around, best + around])
    densities = [-0.5 * np.einsum("ni,ij,nj->n", points - c, hessian, points - c) for c in (size, best)]
    drawn = np.logaddexp(*densities) - np.log(2.0)
    fall = fading(component, np.maximum(np.linalg.norm(points, axis=1), _LEAST * component.low))
    return best, float(logsumexp(densities[0] + fall - drawn) - np.log(len(points)))


def at_lengths(size: Array, hessian: Array, lengths: Array) -> Array:
    """Of all vectors of each length, the one that is most probable by a Gaussian, [lengths, components].

    Args:
        size, hessian: its centre and the inverse of its covariance.
        lengths: greater than zero, all longer than the centre or all shorter.
    """
    stiffness, axes = np.linalg.eigh(hessian)
    # what is fitted as zero along the softest axis may lie on either side of it
    centre = np.tile(axes.T @ size, (len(lengths), 1))
    centre[:, 0] += np.copysign(_LEAST * lengths, centre[:, 0])
    grown = np.linalg.norm(centre, axis=1) < lengths
    low = np.where(grown, np.log(1e-12 * stiffness[0]), np.log(stiffness[0]))
    high = np.where(grown, np.log(stiffness[0]), np.log(1e12 * stiffness[-1]))
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        found = stiffness * centre / (stiffness - stiffness[0] + np.exp(middle)[:, None])
        longer = np.linalg.norm(found, axis=1) > lengths
        low, high = np.where(longer, middle, low), np.where(longer, high, middle)
    found *= (lengths / np.linalg.norm(found, axis=1))[:, None]
    return np.asarray(found @ axes.T)


@lru_cache(maxsize=8)
def _normal_points(count: int) -> Array:
    """Points that are spread like a standard Gaussian, always the same ones, [points, count]."""
    points = np.asarray(norm.ppf(qmc.Sobol(count, scramble=True, rng=np.random.default_rng(0)).random(POINTS)))
    points.flags.writeable = False
    return points
