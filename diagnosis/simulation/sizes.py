"""At which sizes an effect is simulated and how its response is interpolated between them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from diagnosis.effect import SCALAR, Component, Effect, Stage

GRID_POINTS = 49
PIXEL_NODES, BELOW = 10, 0.8
"""So many sizes of an effect on pixels are rendered, from this share of its least: statistics are far from linear."""
FITTED_SHARE = 0.15
"""Relative error of a fitted size at the ends of its prior."""


def node_values(effect: Effect) -> list[float]:
    """Magnitudes to simulate of an effect whose size is one number."""
    component = next(iter(effect.components.values()))
    if effect.random_repeats:
        return [component.high]
    if effect.stage is Stage.SENSOR and not component.signed:
        return [float(size) for size in np.geomspace(BELOW * component.low, component.high, PIXEL_NODES)]
    if effect.vanishes_at_zero:
        steps = (0.25, 0.5, 0.75, 1.0) if effect.stage is Stage.SENSOR else (0.5, 1.0)  # rendering costs little
        sizes = [step * component.high for step in steps]
    else:
        sizes = np.geomspace(component.low, component.high, 4).tolist()
    return [-s for s in reversed(sizes)] + sizes if component.signed else sizes


def nodes(effect: Effect) -> list[dict[str, float]]:
    """Sizes to simulate, place by place; those between them are mixed (:func:`at_all_places`).

    A vector: each component alone, at the length that is typical, first all forward, then all backward (a picture that
    is shifted shows other cells beside the cloth on either side); in each direction it is taken as linear.
    """
    if effect.vector:
        step = vector_step(effect)
        return [
            {name: (way * step if name == chosen else 0.0) for name in effect.components}
            for way in (1.0, -1.0)
            for chosen in effect.components
        ]
    return [{SCALAR: value} | dict(place) for place in effect.places for value in node_values(effect)]


def shortcuts(effect: Effect) -> dict[int, tuple[int, float]]:
    """Nodes whose response is that of another one times a factor, good enough where folds make responses uncertain.

    Large sizes are twice the half ones; of an effect that vanishes as its size grows, only the smallest is simulated.
    """
    if effect.vector or effect.random_repeats:
        return {}
    values = node_values(effect)
    strengths = strength(effect, np.array(values))
    plan: dict[int, tuple[int, float]] = {}
    for place in range(len(effect.places)):
        first = place * len(values)
        for number, value in enumerate(values):
            if not effect.vanishes_at_zero and number:
                plan[first + number] = (first, float(strengths[number] / strengths[0]))
            elif effect.vanishes_at_zero and abs(value) > 0.75 * max(np.abs(values)):
                half = min(range(len(values)), key=lambda k: abs(values[k] - 0.5 * value))
                plan[first + number] = (first + half, 2.0)
    return plan


def aside(effect: Effect) -> frozenset[int]:
    """Nodes at places that are less probable than others: many, so half sizes alone are simulated of them."""
    shares = np.repeat(effect.place_shares, len(nodes(effect)) // len(effect.places))
    return frozenset(np.flatnonzero(shares < shares.max()).tolist())


def at_likeliest_places(effect: Effect) -> Effect:
    """The effect at its likeliest places alone; itself where no place is less probable than another."""
    if not aside(effect):
        return effect
    shares = effect.place_shares
    places = tuple(place for place, share in zip(effect.places, shares, strict=True) if share == shares.max())
    return replace(effect, places=places, odds=(), between=())


def at_all_places(effect: Effect, rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Responses at all places where an effect is tried, from those at the places that are simulated.

    Args:
        effect: whose.
        rows: at :func:`nodes`, [nodes, n].

    Returns:
        The same, followed by those between them, place by place, [nodes of all tried places, n].
    """
    if not effect.between:
        return rows
    by_place = rows.reshape(len(effect.places), -1, rows.shape[1])
    mixed = [sum(share * by_place[number] for number, share in own.shares.items()) for own in effect.between]
    return np.concatenate([rows, *mixed])


def vector_step(effect: Effect) -> float:
    """Length at which each component of a vector is simulated."""
    first = next(iter(effect.components.values()))
    return math.sqrt(first.low * first.high)


def grid(effect: Effect) -> NDArray[np.float64]:
    """Sizes over which a scalar effect is marginalised; from half the prior's least to 1.3 times its largest, or to the
    largest that there can be.
    """
    component = next(iter(effect.components.values()))
    low, high = 0.5 * component.low, min(1.3 * component.high, component.most)
    if component.signed:
        half = np.geomspace(low, high, GRID_POINTS // 2)
        return np.concatenate([-half[::-1], half])
    return np.geomspace(low, high, GRID_POINTS)


def log_prior(effect: Effect, sizes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Log of the prior's weights on :func:`grid`: log-uniform, fading outside the stated range; sums to one."""
    component = next(iter(effect.components.values()))
    log_weight = fading(component, np.abs(sizes))
    return np.asarray(log_weight - np.log(np.exp(log_weight).sum()))


def fading(component: Component, size: NDArray[np.float64]) -> NDArray[np.float64]:
    """Log of the prior's density at sizes outside its range, relative to that at its ends; zero inside.

    A fitted size errs by :data:`FITTED_SHARE`; an effect that is found far smaller than it is ever believed to be is
    more probably another one.
    """
    outside = np.maximum(np.maximum(component.low / size, size / component.high), 1.0)
    return np.asarray(-0.5 * (np.log(outside) / FITTED_SHARE) ** 2)


def interpolation(effect: Effect, sizes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Weights [sizes, nodes] that turn responses at :func:`node_values` into responses at ``sizes``.

    Piecewise linear in the effect's :func:`strength` through zero; beyond the outermost nodes the last piece is
    continued.
    """
    own = strength(effect, np.array(node_values(effect)))
    return _piecewise(tuple(own.tolist()), tuple(strength(effect, sizes).tolist()))


@lru_cache(maxsize=4096)
def _piecewise(nodes: tuple[float, ...], wanted: tuple[float, ...]) -> NDArray[np.float64]:
    """:func:`interpolation` in terms of strengths; asked for again and again, so kept, and not to be written to."""
    own, at = np.array(nodes), np.array(wanted)
    knots = np.sort(np.append(own, 0.0))
    place = np.clip(np.searchsorted(knots, at) - 1, 0, len(knots) - 2)
    share = (at - knots[place]) / (knots[place + 1] - knots[place])
    weights = np.zeros((len(at), len(knots)))
    weights[np.arange(len(at)), place] = 1 - share
    weights[np.arange(len(at)), place + 1] += share
    weights = np.delete(weights, int(np.flatnonzero(knots == 0.0)[0]), axis=1)
    weights = np.ascontiguousarray(weights[:, np.argsort(np.argsort(own))])
    weights.flags.writeable = False
    return weights


def strength(effect: Effect, sizes: NDArray[np.float64]) -> NDArray[np.float64]:
    """What a response is nearly in proportion to: the size, or the inverse of its square where that vanishes."""
    return sizes if effect.vanishes_at_zero else np.asarray(1.0 / sizes**2)


def response_forms(effect: Effect, sizes: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Weights [sizes, nodes] of each form that a response may have: as it was simulated, size by size
    (:func:`interpolation`), or as the weakest size's one in proportion, and as that of the weakest of the other sign
    turned round.

    A strong effect, or one of one sign, may throw the simulation into other folds than those that were captured with
    it; a weak one of either sign more seldom does.
    """
    own = np.array(node_values(effect))
    found = [interpolation(effect, sizes)]
    if not effect.vanishes_at_zero:
        weakest = np.zeros_like(found[0])
        weakest[:, int(np.argmax(own))] = strength(effect, sizes) / strength(effect, own.max())
        return [*found, weakest]
    least = float(np.abs(own).min())
    for turn in (1.0, -1.0) if (own < 0).any() else (1.0,):
        nearest = np.abs(own[None] - turn * least * np.sign(sizes)[:, None]).argmin(axis=1)
        found.append(np.where(np.arange(len(own)) == nearest[:, None], turn * np.abs(sizes)[:, None] / least, 0.0))
    return found


def node_weights(effect: Effect, size: Mapping[str, float]) -> NDArray[np.float64]:
    """Weights of all nodes (of all tried places) that give the response at a size, [nodes]."""
    if effect.vector:
        share = np.array([size[c] for c in effect.components]) / vector_step(effect)
        return np.concatenate([np.maximum(share, 0.0), np.maximum(-share, 0.0)])
    own = interpolation(effect, np.array([size[SCALAR]]))[0]
    place = effect.number_of(size)
    weights = np.zeros(len(own) * len(effect.tried))
    weights[place * len(own) : (place + 1) * len(own)] = own
    return weights
