"""How well each effect explains the captures, its size marginalised."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from diagnosis.effect import SCALAR, Effect, Stage
from diagnosis.effects import get_effect
from diagnosis.inference.block import Block, PixelBlock, View
from diagnosis.inference.intervals import all_inside, size_interval
from diagnosis.inference.likelihood import (
    LikelihoodModel,
    combine,
    over_views,
    pixel_log_likelihood,
)
from diagnosis.inference.scatter import Scatter, scattered_nats, shows_scatter, widened
from diagnosis.inference.vector_fit import fit_vector
from diagnosis.inference.view_likelihood import Known, view_log_likelihood
from diagnosis.simulation.sizes import (
    fading,
    grid,
    interpolation,
    log_prior,
    node_weights,
    response_forms,
    vector_step,
)

Array = NDArray[np.float64]
SIZE_SHARES = {"cloth": 0.2, "camera": 0.15, "scatter": 0.4, "sensor": 0.0}
"""Relative error of a fitted size that all captures share: wrong in form, a simulated response is fitted too short or
too long everywhere; what moved magnets explain of scatter is missing from it."""
FADED = 0.5
"""A size whose prior has faded by more than this is outside its effect's range."""


@dataclass(frozen=True)
class Evidence:
    """One explanation weighed.

    Attributes:
        name: effect, ``none`` or ``unknown``.
        log_evidence: of all captures together, size marginalised.
        best: log likelihood at the best size.
        by_fabric: the same fabric by fabric.
        size: most probable size, by component; empty for ``none`` and ``unknown``.
        usual: the most probable of the sizes inside the effect's range.
        usual_evidence: log evidence of those alone.
        interval_90: of the components that have a prior; all of a vector's lie inside theirs with 90 %.
        at_places: of an effect on a grid of sizes, the most probable one at each of its tried places.
    """

    name: str
    log_evidence: float
    best: float
    by_fabric: dict[str, float]
    size: dict[str, float]
    usual: dict[str, float]
    usual_evidence: float
    interval_90: dict[str, tuple[float, float]]
    at_places: tuple[dict[str, float], ...] = ()


@dataclass(frozen=True)
class Table:
    """Log likelihoods of one explanation at all its sizes (places and sizes in one row, ``s`` long).

    Attributes:
        name: effect, ``none`` or ``unknown``.
        blocks: of each block, [s].
        pixels: of the pixel statistics, [s].
        prior: log weights of the sizes at each place (or, for a vector, its Laplace factor), [s].
        sizes: by component, one entry an ``s``.
        sigma: of a vector's components.
        share: relative error of the size that all captures share.
        hold: log probabilities of what else is averaged over: places, and how magnets hold, [s].
        at_place: so many rows in turn are of one place; 0: the effect is not on a grid of sizes.
    """

    name: str
    blocks: tuple[Array, ...]
    pixels: Array
    prior: Array
    sizes: tuple[dict[str, float], ...]
    sigma: dict[str, float] = field(default_factory=dict)
    share: float = 0.0
    hold: Array | float = 0.0
    at_place: int = 0

    def values(self, blocks: Sequence[Block], best: Sequence[float], model: LikelihoodModel) -> list[float]:
        """Log likelihood of each block at the most probable size."""
        total, _ = combine(blocks, self.blocks, best, model)
        top = int(np.argmax(total + self.pixels + self.prior + self.hold))
        return [float(values[top]) for values in self.blocks]

    def chance(self, size: Mapping[str, float]) -> float:
        """Log probability beforehand of one of the sizes, its place included."""
        return float((self.prior + self.hold)[self.sizes.index(dict(size))])

    def weigh(self, blocks: Sequence[Block], best: Sequence[float], model: LikelihoodModel) -> Evidence:
        """Combine blocks, marginalise the size."""
        total, fabrics = combine(blocks, self.blocks, best, model)
        likelihood = total + self.pixels
        posterior = likelihood + self.prior + self.hold
        evidence = float(logsumexp(posterior))
        top = int(np.argmax(posterior))
        size = self.sizes[top]
        # a vector's factors say how sharp its fits are, not how usual its sizes
        usable = np.ones(len(posterior), dtype=bool) if self.sigma else self.prior > self.prior.max() - FADED
        inside = np.where(usable, posterior, -np.inf)
        usual, usual_evidence = self.sizes[int(np.argmax(inside))], float(logsumexp(inside))
        if self.sigma:
            shared = self.share * float(np.linalg.norm([size[n] for n in self.sigma]))
            wide = all_inside(len(self.sigma))
            half = {n: wide * float(np.hypot(d, shared)) for n, d in self.sigma.items()}
            interval = {n: (size[n] - h, size[n] + h) for n, h in half.items()}
        elif SCALAR in size:
            values = np.array([s[SCALAR] for s in self.sizes])
            interval = {SCALAR: size_interval(values, np.exp(posterior - evidence), size[SCALAR], self.share)}
        else:
            interval = {}
        by_fabric = {key: float(value[top]) for key, value in fabrics.items()}
        reached = float(likelihood[top])
        there = self._at_places(posterior)
        return Evidence(self.name, evidence, reached, by_fabric, size, usual, usual_evidence, interval, there)

    def _at_places(self, posterior: Array) -> tuple[dict[str, float], ...]:
        """The most probable size at each place, however magnets hold."""
        if not self.at_place:
            return ()
        count = len(get_effect(self.name).tried)
        best = posterior.reshape(-1, count, self.at_place).max(axis=0).argmax(axis=1)
        return tuple(self.sizes[place * self.at_place + int(row)] for place, row in enumerate(best))


@dataclass(frozen=True)
class Tables:
    """All explanations by one.

    Attributes:
        nothing, unknown: of no effect, and of something outside the catalogue.
        effects: of every effect that is tried.
    """

    nothing: Table
    unknown: Table
    effects: tuple[Table, ...]

    def __iter__(self) -> Iterator[Table]:
        return iter((self.nothing, self.unknown, *self.effects))


def tabulate(
    effect: Effect,
    blocks: Sequence[Block],
    pixels: PixelBlock,
    model: LikelihoodModel,
    seen: Sequence[float] | None = None,
    *,
    as_simulated: bool = False,
) -> Table:
    """Log likelihoods of one effect, its size common to all fabrics.

    Args:
        effect: see there.
        blocks, pixels: what was measured.
        model: of the likelihood.
        seen: log likelihood of each block in the folds that were found without the effect; by default as it is.
        as_simulated: responses have no other form (:func:`diagnosis.simulation.sizes.response_forms`).
    """
    kind = "scatter" if effect.random_repeats else "cloth" if effect.moves_cloth else effect.stage.value
    if seen is None and (effect.moves_cloth or effect.stage is Stage.CAMERA):
        seen = [float(still.max()) for still in tabulate_nothing(blocks, pixels, model).blocks]
    table = replace(_tabulate_one(effect, blocks, pixels, model, as_simulated, seen), share=SIZE_SHARES[kind])
    if not effect.moves_cloth and not (effect.stage is Stage.CAMERA and model.rough):
        return table
    assert seen is not None
    own = zip(blocks, table.blocks, seen, strict=True)
    return replace(table, blocks=tuple(or_unmoved(b.scene, value, still, model) for b, value, still in own))


def _tabulate_one(
    effect: Effect,
    blocks: Sequence[Block],
    pixels: PixelBlock,
    model: LikelihoodModel,
    as_simulated: bool,
    seen: Sequence[float] | None,
) -> Table:
    if effect.vector:
        return _tabulate_vector(effect, blocks, pixels, model, seen)
    if effect.random_repeats:
        return _tabulate_scatter(effect, blocks, pixels, model)
    return _tabulate_scalar(effect, blocks, pixels, model, as_simulated or not effect.moves_cloth)


def or_unmoved(scene: str, value: Array, still: Array | float, model: LikelihoodModel) -> Array:
    """Of a block whose folds may be those seen without the effect although the continued simulation left them."""
    moved = model.moved(scene)
    return value if moved == 0.0 else np.asarray(np.logaddexp(np.log1p(-moved) + value, np.log(moved) + still))


def tabulate_nothing(blocks: Sequence[Block], pixels: PixelBlock, model: LikelihoodModel) -> Table:
    """Of no effect."""
    values = tuple(_of_blocks(blocks, None, np.zeros((1, 0)), model))
    calm = pixel_log_likelihood(pixels, np.zeros((1, len(pixels.measured))), model)
    return Table("none", values, calm, np.zeros(1), ({},))


def _of_blocks(blocks: Sequence[Block], name: str | None, weights: Array, model: LikelihoodModel) -> Array:
    """Log likelihood of each block without what an effect does at each of its sizes, [blocks, sizes].

    Args:
        blocks: see there.
        name: of the effect; None: nothing is taken away.
        weights: of the responses at its nodes, [sizes, nodes].
        model: see there.
    """
    if not blocks:
        return np.zeros((0, len(weights)))
    return _over_blocks(_known(blocks, name).log_likelihood(weights, model), model)


def _at_places(blocks: Sequence[Block], name: str, weights: Array, places: int, model: LikelihoodModel) -> Array:
    """The same of an effect at each of its places, [blocks, places, sizes].

    Args:
        blocks, name, model: see :func:`_of_blocks`.
        weights: of the responses at the nodes of one place, [sizes, nodes].
        places: how many it is tried at; responses at one lie beside each other.
    """
    if not blocks:
        return np.zeros((0, places, len(weights)))
    known, nodes = _known(blocks, name), weights.shape[1]
    parts = [known.at(slice(n * nodes, (n + 1) * nodes)).log_likelihood(weights, model) for n in range(places)]
    return np.stack([_over_blocks(part, model) for part in parts], axis=1)


def _known(blocks: Sequence[Block], name: str | None) -> Known:
    """Of all blocks, each with its stated parameters and as if they were wrong."""
    views = [view for block in blocks for view in block.views]
    rows = [np.zeros((0, len(view.measured))) if name is None else view.responses[name] for view in views]
    return Known.of(views, rows, [block.scene for block in blocks for _ in block.views])


def _over_blocks(values: Array, model: LikelihoodModel) -> Array:
    """Of blocks whose fabric may have wrong parameters: [blocks times views, sizes] to [blocks, sizes]."""
    return over_views(np.stack([values[::2], values[1::2]]), model)


def _at_rest(view: View, scene: str, model: LikelihoodModel) -> Array:
    return view_log_likelihood(view, np.zeros((0, len(view.measured))), np.zeros((1, 0)), scene, model)


def _tabulate_scalar(
    effect: Effect, blocks: Sequence[Block], pixels: PixelBlock, model: LikelihoodModel, as_simulated: bool
) -> Table:
    """On a grid of sizes and over the effect's places; each block's response is of one of several forms."""
    sizes = grid(effect)
    weights = [interpolation(effect, sizes)] if as_simulated else response_forms(effect, sizes)
    places = len(effect.tried)
    values = []
    of_all = _at_places(blocks, effect.name, np.concatenate(weights), places, model)
    by_form = (
        of_all.reshape(len(blocks), places, len(weights), -1).swapaxes(1, 2).reshape(len(blocks), len(weights), -1)
    )
    for block, of_one in zip(blocks, by_form, strict=True):
        found = list(of_one)
        for name, forms in _twin_forms(effect, sizes, block, as_simulated):
            found += list(_of_blocks([block], name, np.concatenate(forms), model).reshape(len(forms), -1))
        values.append(np.asarray(np.logaddexp.reduce(found, axis=0) - np.log(len(found))))
    seen = np.kron(np.eye(places), weights[0]) @ pixels.responses[effect.name]
    return Table(
        effect.name,
        tuple(values),
        pixel_log_likelihood(pixels, seen, model, pixels.vagueness(effect.name)),
        np.tile(log_prior(effect, sizes), places),
        tuple({SCALAR: float(size)} | dict(place) for place in effect.tried for size in sizes),
        hold=np.repeat(np.log(effect.tried_shares), len(sizes)),
        at_place=len(sizes),
    )


def _twin_forms(effect: Effect, sizes: Array, block: Block, as_simulated: bool) -> list[tuple[str, list[Array]]]:
    """Forms of the response to an effect's twin at the sizes that do the same to this fabric: which of the two was
    simulated in the folds that are seen is chance, how their sizes go with the density is not.
    """
    twin = effect.twin
    if twin is None or twin.name not in block.stated.responses or not np.isfinite(block.density):
        return []
    other, alike = get_effect(twin.name), twin.size(sizes, block.density)
    forms = [interpolation(other, alike)] if as_simulated else response_forms(other, alike)
    return [(twin.name, forms)]


def _tabulate_scatter(effect: Effect, blocks: Sequence[Block], pixels: PixelBlock, model: LikelihoodModel) -> Table:
    """An effect that is another in every repeat widens the blocks' covariance.

    Its many directions explain any small errors, and the others are then smaller still: errors that are no larger than
    modelled gain nothing by it.
    """
    sizes = grid(effect)
    modelled = replace(model, least_scale=1.0)
    values = []
    for block, shown in zip(blocks, shows_scatter(blocks), strict=True):
        if not shown:
            still = [_at_rest(view, block.scene, model) for view in block.views]
            values.append(np.repeat(over_views(np.stack(still), model), len(sizes)))
            continue
        rows = []
        for view in block.views:
            wider = widened(view, Scatter.of(view, block, effect, sizes), block.scene, modelled)
            gain = wider - _at_rest(view, block.scene, modelled)
            rows.append(_at_rest(view, block.scene, model) + gain)
        values.append(over_views(np.stack(rows), model))
    calm = pixel_log_likelihood(pixels, np.zeros((1, len(pixels.measured))), model)
    counted = [block for block, shown in zip(blocks, shows_scatter(blocks), strict=True) if shown]
    scattered = min(0.0, sum(scattered_nats(block) for block in counted))
    place = dict(effect.places[0])
    return Table(
        effect.name,
        tuple(values),
        np.repeat(calm + scattered, len(sizes)),
        log_prior(effect, sizes),
        tuple({SCALAR: float(size)} | place for size in sizes),
    )


def _tabulate_vector(
    effect: Effect,
    blocks: Sequence[Block],
    pixels: PixelBlock,
    model: LikelihoodModel,
    seen: Sequence[float] | None = None,
) -> Table:
    """Response linear in each direction, Gaussian prior, Laplace's approximation at the best of several fits.

    The fit begins in every orthant, because a component's response forward is another one than backward. ``seen``: of
    each block, log likelihood in folds in which the effect may not show; None: it shows in all.
    """
    count = len(effect.components)
    prior_sigma = 1.2 * vector_step(effect) / np.sqrt(count)
    known = _known(blocks, effect.name)
    stated = known.every(slice(0, None, 2))
    found: list[tuple[float, int, Array, Array, tuple[Array, ...], Array, float]] = []
    for signs in product((1.0, -1.0), repeat=count):
        size, hessian = fit_vector(effect, stated, pixels, model, seen, np.array(signs) * 1e-9 * prior_sigma)
        weights = node_weights(effect, dict(zip(effect.components, size.tolist(), strict=True)))
        values = _over_blocks(known.log_likelihood(weights[None], model), model)
        shared = pixel_log_likelihood(pixels, (weights @ pixels.responses[effect.name])[None], model)
        occam = -0.5 * float(size @ size) / prior_sigma**2 - count * np.log(prior_sigma)
        occam -= 0.5 * float(np.linalg.slogdet(hessian)[1])
        occam += float(fading(next(iter(effect.components.values())), np.array(max(np.linalg.norm(size), 1e-12))))
        total = float(values.sum() + shared.sum() + occam)
        found.append((total, len(found), size, hessian, tuple(values), shared, occam))
    _, _, size, hessian, by_block, shared, occam = max(found)
    sigma = np.sqrt(np.diag(np.linalg.inv(hessian)))
    return Table(
        effect.name,
        by_block,
        shared,
        np.array([occam]),
        ({n: float(s) for n, s in zip(effect.components, size, strict=True)},),
        {n: float(d) for n, d in zip(effect.components, sigma, strict=True)},
    )
