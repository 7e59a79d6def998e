"""Which effects given captures can tell apart, known before anything is captured: from simulated responses alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from capture.capture_set import CaptureSet
from diagnosis.effect import SCALAR, Effect
from diagnosis.effects import get_effect
from diagnosis.inference.block import Block, PixelBlock, make_block, make_pixel_block
from diagnosis.inference.likelihood import LikelihoodModel
from diagnosis.inference.noise import NoiseModel
from diagnosis.simulation.drape_cache import DrapeCache
from diagnosis.simulation.sizes import grid, interpolation, node_weights
from simcore.mesh import GridMesh

Array = NDArray[np.float64]
SEPARABLE_NATS = 3.0
"""Explanations whose expected log likelihoods differ by less cannot be told apart (odds of 20 to 1)."""


@dataclass(frozen=True)
class Separation:
    """How well one effect can be told from another.

    Attributes:
        effect, other: the true one, and the one that tries to explain it.
        share: of the true effect's response (squared, in units of the errors) that the other leaves over; 0 = the same.
        nats: log likelihood by which the true one is expected to win.
        own_nats: the same against no effect.
    """

    effect: str
    other: str
    share: float
    nats: float
    own_nats: float


@dataclass(frozen=True)
class Signature:
    """Responses of all blocks and the pixel statistics, side by side, weighted so that half the square is in nats.

    Attributes:
        blocks, pixels: what they were made from.
        weight: of a block's square.
    """

    blocks: Sequence[Block]
    pixels: PixelBlock
    weight: float

    def of(self, effect: Effect, size: Mapping[str, float]) -> Array:
        """Response to an effect of one size, [all]."""
        return np.asarray(self.rows(effect, _place(effect, size), weights_of(effect, size))[0])

    def rows(self, effect: Effect, place: int, weights: Array) -> Array:
        """Responses for rows of node weights [sizes, nodes], [sizes, all]."""
        own = slice(place * weights.shape[1], (place + 1) * weights.shape[1])
        parts = [self.weight**0.5 * (weights @ b.stated.responses[effect.name][own]) for b in self.blocks]
        return np.concatenate([*parts, weights @ self.pixels.responses[effect.name][own]], axis=1)


def weights_of(effect: Effect, size: Mapping[str, float]) -> Array:
    """Weights of the nodes (of the size's place) for one size, [1, nodes]."""
    if effect.vector:
        return node_weights(effect, size)[None]
    return interpolation(effect, np.array([size[SCALAR]]))


def _place(effect: Effect, size: Mapping[str, float]) -> int:
    for number, place in enumerate(effect.places):
        if all(size.get(key, value) == value for key, value in place.items()):
            return number
    return 0


def leftover(signature: Signature, target: Array, other: Effect) -> float:
    """Square that is left of a response when another effect explains it as well as it can."""
    best = float(target @ target)
    if other.vector:
        columns = signature.rows(other, 0, np.eye(2 * len(other.components)))
        return min(best, float(nnls(columns.T, target)[1] ** 2))
    for place in range(len(other.places)):
        rows = signature.rows(other, place, interpolation(other, grid(other)))
        best = min(best, float(np.min(np.sum((target - rows) ** 2, axis=1))))
    return best


def separations(
    sizes: Mapping[str, Mapping[str, float]], blocks: Sequence[Block], pixels: PixelBlock, model: LikelihoodModel
) -> list[Separation]:
    """Every effect at a given size against every other; effects that only scatter are left out.

    Args:
        sizes: effect to the size at which it is to be told from the others.
        blocks, pixels: of any captures; only responses are used.
        model: for the share of independent dimensions.
    """
    names = list(blocks[0].stated.responses)
    signature = Signature(blocks, pixels, model.dimension_share)
    found = []
    for name, size in sizes.items():
        if name not in names:
            continue
        target = signature.of(get_effect(name), size)
        square = float(target @ target)
        for other in names:
            if other != name and square > 0.0:
                left = leftover(signature, target, get_effect(other))
                found.append(Separation(name, other, left / square, 0.5 * left, 0.5 * square))
    return found


def not_separable(
    name: str, size: Mapping[str, float], blocks: Sequence[Block], pixels: PixelBlock, model: LikelihoodModel
) -> tuple[str, ...]:
    """Effects that these captures cannot tell from one of this size."""
    found = separations({name: size}, blocks, pixels, model)
    return tuple(sorted(s.other for s in found if s.nats < SEPARABLE_NATS))


def own_nats(
    sizes: Mapping[str, Mapping[str, float]], blocks: Sequence[Block], pixels: PixelBlock, model: LikelihoodModel
) -> dict[str, float]:
    """Log likelihood by which each effect, at a given size, is expected to win against no effect."""
    signature = Signature(blocks, pixels, model.dimension_share)
    targets = {name: signature.of(get_effect(name), size) for name, size in sizes.items()}
    return {name: 0.5 * float(target @ target) for name, target in targets.items()}


@dataclass(frozen=True)
class Isolability:
    """What captures of some fabrics and scenes can tell apart; from simulations alone.

    Attributes:
        pairs: every effect but those left out, at a typical size, against every other one, the worst first; an effect
            that changes nothing at all in these scenes has none.
        scenes: the scenes that were analysed.
        own_nats: the same effects against no effect.
        left_out: effects that differ from repeat to repeat: they widen the scatter in no direction of their own, and
            whether one is there hangs on the number of repeats.
    """

    pairs: tuple[Separation, ...]
    scenes: tuple[str, ...]
    own_nats: Mapping[str, float]
    left_out: tuple[str, ...] = ()

    def confused(self) -> tuple[Separation, ...]:
        """The pairs that cannot be told apart."""
        return tuple(p for p in self.pairs if p.nats < SEPARABLE_NATS)

    def invisible(self) -> tuple[str, ...]:
        """Effects whose own response drowns in the errors."""
        return tuple(sorted(name for name, nats in self.own_nats.items() if nats < SEPARABLE_NATS))


def analyse(
    captures: CaptureSet,
    effects: tuple[str, ...],
    resolution_m: float,
    cache: DrapeCache,
    on_fabric: Callable[[float], None] | None = None,
) -> Isolability:
    """Before (or without) looking at what the captures show: fabrics, scenes, camera and sensor as the set states them.

    No picture need be there where the set states parameters, density and pose (:mod:`diagnosis.tasks.planned`).

    Args:
        captures: taken or planned.
        effects: names; those that differ from repeat to repeat are left out.
        resolution_m: wanted edge of a mesh cell.
        cache: of simulations.
        on_fabric: called with 1 for every fabric.

    Raises:
        InputError: captures that cannot be used, or a plan that does not state what pictures would have to tell.
        SimulationError: simulations that do not come to rest.
    """
    from diagnosis.measurement.picture import picture_of
    from diagnosis.simulation.simulator import Simulator
    from diagnosis.tasks.fabric_task import CaptureTask, base_states, explain_fabric
    from diagnosis.tasks.planned import planned_tasks

    results = []
    for task in planned_tasks(captures, effects, resolution_m):
        simulator = Simulator(cache)
        shown: list[CaptureTask] = []
        for capture in task.captures:
            mesh = GridMesh(task.resolution_m, capture.scene.setup.sample_size_m)
            base = base_states(simulator, task.parameters, capture.scene, mesh)[0]
            rng = np.random.default_rng(len(shown))
            picture = picture_of(base.drape, capture.scene)
            shown.append(replace(capture, depth=capture.scene.sensor.apply(picture, rng, camera=capture.scene.camera)))
        results.append(explain_fabric(replace(task, captures=tuple(shown)), cache))
        if on_fabric is not None:
            on_fabric(1.0)
    noise, model = NoiseModel(), LikelihoodModel()
    found = [c for r in results for c in r.captures]
    blocks = [
        make_block([c for c in r.captures if c.scene == scene], r.task.relative_sigma, noise)
        for r in results
        for scene in sorted({c.scene for c in r.captures})
    ]
    pixels = make_pixel_block(found, noise)
    typical = {name: get_effect(name).typical() for name in effects if not get_effect(name).random_repeats}
    pairs = separations(typical, blocks, pixels, model)
    return Isolability(
        tuple(sorted(pairs, key=lambda p: p.nats)),
        tuple(sorted({b.scene for b in blocks})),
        own_nats(typical, blocks, pixels, model),
        tuple(name for name in effects if name not in typical),
    )


REMEDIES: Mapping[frozenset[str], str] = MappingProxyType(
    {
        frozenset({"depth_scale", "depth_bias"}): "capture once more from another distance",
        frozenset({"depth_scale", "camera_translation"}): "capture once more from another distance",
        frozenset({"depth_bias", "camera_translation"}): "measure the camera's distance, or capture from another one",
        frozenset({"depth_scale", "focal_scale"}): "capture once more from another distance",
        frozenset({"air_draft", "panel_tilt"}): "add fabrics of other weight, or lay a level on the panel",
        frozenset({"pin_drop", "camera_rotation"}): "show the camera the bare panel with a plumb line",
    }
)


def remedy(pair: Separation) -> str:
    """What would separate two effects."""
    known = REMEDIES.get(frozenset({pair.effect, pair.other}))
    if known is not None:
        return known
    stages = {get_effect(pair.effect).stage.value, get_effect(pair.other).stage.value}
    if "setup" in stages:
        return "capture once more with another pin distance"
    if "fabric" in stages:
        return "capture once more with the sample turned by a quarter"
    return "add repeats and fabrics"
