"""What is held out in turn: captures that had no part in finding or fitting an effect."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass

from diagnosis.inference.block import Block, PixelBlock, make_block, make_pixel_block
from diagnosis.inference.noise import NoiseModel
from diagnosis.tasks.fabric_task import CaptureResult, FabricResult


@dataclass(frozen=True)
class Fold:
    """One part of a set and the rest of it.

    Attributes:
        name: of the part.
        held: blocks of the captures that are held out.
        whole: of each the block with all repeats: what these scatter is the floor.
        held_pixels: what they share.
        rest: blocks that effects are found and fitted on.
        rest_pixels: what those share.
    """

    name: str
    held: tuple[Block, ...]
    whole: tuple[Block, ...]
    held_pixels: PixelBlock
    rest: tuple[Block, ...]
    rest_pixels: PixelBlock


def folds_of(results: Sequence[FabricResult], blocks: Sequence[Block], noise: NoiseModel) -> list[Fold]:
    """Fabric by fabric; of a single fabric repeat by repeat; of a single repeat scene by scene.

    Args:
        results: of all fabrics.
        blocks: of all of them; a fold shares those that it does not divide.
        noise: model of errors.

    Returns:
        Empty where there is one capture alone: nothing can be held out.
    """
    for parts in _divisions([c for r in results for c in r.captures]):
        names = sorted(set(parts.values()))
        if len(names) > 1:
            return [_fold(name, parts, results, blocks, noise) for name in names]
    return []


def _divisions(captures: Sequence[CaptureResult]) -> tuple[Mapping[str, str], ...]:
    """Part of each capture by its id, in the ways to divide a set, the best first."""
    turn: dict[str, str] = {}
    seen: dict[tuple[str, str], int] = {}
    for capture in sorted(captures, key=lambda c: c.repeat):  # repeats of two scenes need not have the same numbers
        number = seen.get((capture.fabric, capture.scene), 0)
        seen[capture.fabric, capture.scene] = number + 1
        turn[capture.id] = f"repeat {number:04d}"
    return {c.id: c.fabric for c in captures}, turn, {c.id: c.scene for c in captures}


def _fold(
    name: str,
    parts: Mapping[str, str],
    results: Sequence[FabricResult],
    blocks: Sequence[Block],
    noise: NoiseModel,
) -> Fold:
    held = {capture for capture, part in parts.items() if part == name}
    rest = parts.keys() - held
    return Fold(
        name,
        held=_blocks(held, results, blocks, noise),
        whole=tuple(block for block in blocks if held & set(block.captures)),
        held_pixels=_pixels(held, results, noise),
        rest=_blocks(rest, results, blocks, noise),
        rest_pixels=_pixels(rest, results, noise),
    )


def _blocks(
    wanted: Set[str], results: Sequence[FabricResult], blocks: Sequence[Block], noise: NoiseModel
) -> tuple[Block, ...]:
    found = []
    for block in blocks:
        own = wanted & set(block.captures)
        if len(own) == len(block.captures):
            found.append(block)
        elif own:
            (result,) = (r for r in results if r.task.id == block.fabric)
            captures = [c for c in result.captures if c.id in own]
            task = result.task
            found.append(make_block(captures, task.relative_sigma, noise, task.parameters.density))
    return tuple(found)


def _pixels(wanted: Set[str], results: Sequence[FabricResult], noise: NoiseModel) -> PixelBlock:
    return make_pixel_block([c for r in results for c in r.captures if c.id in wanted], noise)
