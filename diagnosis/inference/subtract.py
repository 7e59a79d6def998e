"""Measurements with an effect's response taken away."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from diagnosis.effect import SCALAR
from diagnosis.effects import get_effect
from diagnosis.inference.block import Block, PixelBlock, View
from diagnosis.simulation.sizes import node_values, node_weights

Array = NDArray[np.float64]
Known = TypeVar("Known", View, PixelBlock)


def response_to(responses: Mapping[str, Array], name: str, size: Mapping[str, float]) -> Array:
    """Response to an effect of one size, [n]; nothing for an effect that only scatters repeats.

    Args:
        responses: effect to its response at each of its nodes, [nodes, n].
        name: of the effect.
        size: its components and its place.
    """
    effect = get_effect(name)
    if effect.random_repeats:
        return np.zeros(next(iter(responses.values())).shape[1])
    return np.asarray(node_weights(effect, size) @ responses[name])


def responses_at_place(responses: Mapping[str, Array], name: str, size: Mapping[str, float]) -> Array:
    """Responses to an effect at all its nodes of one place, [nodes of the place, n].

    Args:
        responses, name, size: as in :func:`response_to`; ``size`` gives the place.
    """
    effect = get_effect(name)
    if effect.vector:
        return responses[name]
    here = effect.number_of(size)
    count = len(node_values(effect))
    return responses[name][here * count : (here + 1) * count]


def as_seen(block: Block, name: str, size: Mapping[str, float]) -> tuple[str, Mapping[str, float]]:
    """The effect, or its twin at the size that does the same to the block's fabric, whichever leaves less of it."""
    twin = get_effect(name).twin
    if twin is None or twin.name not in block.stated.responses or not np.isfinite(block.density):
        return name, size
    other = {SCALAR: float(twin.size(np.array([size[SCALAR]]), block.density)[0])}

    def left(source: tuple[str, Mapping[str, float]]) -> float:
        return float(np.linalg.norm(block.stated.measured - response_to(block.stated.responses, *source)))

    return min((name, size), (twin.name, other), key=left)


def without(block: Block, name: str, size: Mapping[str, float]) -> Block:
    """A block as if the effect had been simulated too; its response stays as uncertain as that of an effect alone."""
    if get_effect(name).random_repeats:
        return block
    source = as_seen(block, name, size)
    stated, wide = (_without(view, response_to(view.responses, *source)) for view in block.views)
    return replace(block, stated=stated, wide=wide)


def beside_each_other(blocks: Sequence[Block], names: Sequence[str]) -> list[Block]:
    """Blocks whose responses to two effects are those beside the other, where these were simulated; of one, as is."""
    return [together(block, *names) for block in blocks] if len(names) == 2 else list(blocks)


def without_both(blocks: Sequence[Block], sizes: Mapping[str, Mapping[str, float]]) -> list[Block]:
    """Blocks without one effect or two, of these sizes; of two, what each does beside the other where that is known."""
    left = beside_each_other(blocks, [name for name in sizes if not get_effect(name).random_repeats])
    for name, size in sizes.items():
        left = [without(block, name, size) for block in left]
    return left


def _without(view: View, response: Array) -> View:
    return replace(view, measured=view.measured - response, taken=(*view.taken, response))


def together(block: Block, name: str, other: str) -> Block:
    """A block whose responses to one of two effects are those beside the other, where these were simulated."""
    stated, wide = (_together(view, name, other) for view in block.views)
    return replace(block, stated=stated, wide=wide)


def pixels_together(pixels: PixelBlock, name: str, other: str) -> PixelBlock:
    """The same of pixel statistics."""
    return _together(pixels, name, other)


def _together(known: Known, name: str, other: str) -> Known:
    # of the likelier ``name`` and a second one, what the second does beside it is what was simulated together last
    key = next((key for key in ((other, name), (name, other)) if key in known.beside), None)
    return known if key is None else replace(known, responses=known.responses | {key[0]: known.beside[key]})


def pixels_without_both(pixels: PixelBlock, sizes: Mapping[str, Mapping[str, float]]) -> PixelBlock:
    """The numbers that all captures share without two effects, of these sizes."""
    left = pixels_together(pixels, *sizes)
    for name, size in sizes.items():
        left = pixels_without(left, name, size)
    return left


def pixels_without(pixels: PixelBlock, name: str, size: Mapping[str, float]) -> PixelBlock:
    """The same of pixel statistics."""
    if get_effect(name).random_repeats:
        return pixels
    response = response_to(pixels.responses, name, size)
    return replace(
        pixels,
        measured=pixels.measured - response,
        taken=(*pixels.taken, response),
        vague=pixels.vague + pixels.vagueness(name) ** 2,
    )
