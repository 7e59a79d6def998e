"""How far the gap shrinks on captures that had no part in finding or fitting the effect."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from diagnosis.afresh.fresh import FreshLook, Sized
from diagnosis.afresh.side_by_side import side_by_side
from diagnosis.effect import Stage
from diagnosis.effects import get_effect
from diagnosis.gap.floor import repeat_squares
from diagnosis.gap.regions import REGIONS, region_of_cells
from diagnosis.groups import NOT_EFFECTS, group_of
from diagnosis.inference.block import Block, PixelBlock
from diagnosis.inference.cause import Cause, name_cause
from diagnosis.inference.likelihood import LikelihoodModel
from diagnosis.inference.subtract import pixels_without, pixels_without_both, response_to, without_both
from diagnosis.measurement.reference import cell_centres
from diagnosis.report import Control, RegionShrinkage, Shrinkage
from diagnosis.shrinkage.shares import fraction_of, interval_of
from diagnosis.shrinkage.splits import Fold
from diagnosis.workers import ALONE, Workers

Array = NDArray[np.float64]
PLAIN = 3.0
"""Standard deviations beyond which a shared number shows an effect."""


@dataclass(frozen=True)
class Judge:
    """Takes effects out of blocks: by fresh simulation where it has the fabric's states, else by known responses.

    Attributes:
        looks: by fabric; empty: nothing is simulated.
        workers: that simulate fabrics side by side.
    """

    looks: Mapping[str, FreshLook]
    workers: Workers = ALONE

    def prepare(self, blocks: Sequence[Block], effects: Mapping[str, Sequence[Sized]]) -> None:
        """Simulate what :meth:`response` will be asked for: of the blocks, by fabric the effects."""
        if self.workers.count <= 1 or not effects.keys() <= self.looks.keys():
            return
        captures = [name for block in blocks for name in block.captures]
        work = partial(_simulate, captures=captures, effects=effects)
        side_by_side(work, [self.looks[fabric] for fabric in effects], self.workers)

    def response(self, block: Block, effects: Sequence[Sized]) -> Array:
        """Change of a block's measurements by effects together [m], [n].

        Where that does not come to rest, as known from responses, or, where these were not simulated, as far as it came
        (nothing, where it diverged).
        """
        shown = on_shapes(effects)
        if not shown:
            return np.zeros(len(block.owner))
        look = self.looks.get(block.fabric)
        if look is None:
            return block.metres(whitened(block, shown))
        own = [{c.id: c for c in look.result.captures}[name] for name in block.captures]
        drapes = [look.drape(capture, shown) for capture in own]
        rest = np.array([d is c.base or d.drape.ok for d, c in zip(drapes, own, strict=True)])
        changes = np.stack([look.change(capture, shown) for capture in own])[block.owner, block.cell]
        if rest.all() or not {name for name, _ in shown} <= block.stated.responses.keys():
            return changes
        return np.where(rest[block.owner], changes, block.metres(whitened(block, shown)))


def not_at_rest_with(held: Sequence[Held], looks: Mapping[str, FreshLook]) -> list[str]:
    """Captures that no simulation with what was found stands for, since it does not come to rest, in words."""
    unrested = []
    for one in held:
        shown, look = on_shapes(one.effects), looks.get(one.block.fabric)
        if look is None or not shown:
            continue
        for capture in (c for c in look.result.captures if c.id in one.block.captures):
            found = look.drape(capture, shown)
            unrested += [capture.id] if found is not capture.base and not found.drape.ok else []
    if not unrested:
        return []
    return [
        f"{', '.join(sorted(set(unrested)))}: with what was found their simulation does not come to rest; how far the "
        "gap shrinks there is told from responses to smaller sizes, not from a fresh simulation"
    ]


def _simulate(look: FreshLook, captures: Sequence[str], effects: Mapping[str, Sequence[Sized]]) -> None:
    """A fabric with its effects on, for some of the captures."""
    shown = on_shapes(effects[look.result.task.id])
    for capture in look.result.captures:
        if shown and capture.id in captures:
            look.drape(capture, shown)


def on_shapes(effects: Sequence[Sized]) -> list[Sized]:
    """Those that change a cell in all captures alike: not by chance, from repeat to repeat or from pixel to pixel."""
    return [(name, size) for name, size in effects if not (get_effect(name).random_repeats or get_effect(name).white)]


def sized(cause: Cause) -> list[Sized]:
    """The named effects with their sizes."""
    return [(name, cause.size(name)) for name in cause.named]


def whitened(block: Block, effects: Sequence[Sized]) -> Array:
    """Whitened response of a block to effects at some sizes, as far as it is known without a simulation, [n]."""
    own = {name: size for name, size in effects if not get_effect(name).random_repeats}
    (left,) = without_both([block], own)
    return np.asarray(block.stated.measured - left.stated.measured)


@dataclass(frozen=True)
class Refit:
    """A block after an effect and the best parameters within their stated uncertainty.

    Attributes:
        left: what is left [m], [n].
        variance: what is expected of it without any effect [m²], [n].
        deviation: of the seven parameters from what is stated, in stated standard deviations, [7].
    """

    left: Array
    variance: Array
    deviation: Array


def refit(block: Block, response: Array) -> Refit:
    """Take a response [m] out and refit the parameters by their posterior mean under the block's covariance."""
    residual = block.metres(block.stated.measured) - response
    covariance = block.stated.factor @ block.stated.factor.T
    gain = block.jacobian @ np.linalg.inv(covariance)
    deviation = gain @ residual
    spread = np.eye(len(residual)) - block.jacobian.T @ gain
    variance = np.einsum("ij,jk,ik->i", spread, covariance, spread, optimize=True)
    return Refit(np.asarray(residual - block.jacobian.T @ deviation), variance, np.asarray(deviation))


@dataclass(frozen=True)
class Held:
    """A block that was held out.

    Attributes:
        block: it.
        effects: found and fitted without it.
        squares: mean squares before, after, of the floor and after the control, by region, ``all`` last [m²],
            [regions, 4].
        before, after: refitted parameters, in stated standard deviations, without and with the effects, [7].
        repeated: the floor is what repeats scatter by, not what errors are expected to make.
    """

    block: Block
    effects: tuple[Sized, ...]
    squares: Array
    before: Array
    after: Array
    repeated: bool = False


@dataclass(frozen=True)
class Measured:
    """A shrinkage with what it rests on.

    Attributes:
        shrinkage: it.
        held: blocks that it was measured on; none where it is judged by shared numbers.
        seen: those then, which show in depth what the numbers say; without squares, parameters as stated.
    """

    shrinkage: Shrinkage
    held: tuple[Held, ...]
    seen: tuple[Held, ...] = ()


def measure_shrinkage(
    cause: Cause,
    effects: tuple[str, ...],
    folds: Sequence[Fold],
    pixels: PixelBlock,
    model: LikelihoodModel,
    judge: Judge = Judge({}),
    *,
    known: bool = False,
    without: Collection[str] = (),
) -> Measured | None:
    """Fold by fold: each is judged with the effect named and fitted on the others.

    Only ``stretch`` counts where there is any, as for the gap: ``hanging`` shows which folds fell rather than what is
    missing. What camera and sensor change is no shape: it is judged by the numbers that a set shares (pixel statistics,
    the panel's plane), in standard deviations, where they show it.

    Args:
        cause: found on everything.
        effects: names that were tried.
        folds: what is held out in turn.
        pixels: what the whole set shares.
        model: see there.
        judge: simulates what is found.
        known: what is named on everything is taken as known; only its sizes are fitted on the others.
        without: effects that were refuted: they are not named on the others either.

    Returns:
        None when no effect is named or nothing can be held out.
    """
    if cause.top in NOT_EFFECTS or not folds:
        return None
    numbers = pixels.measured
    in_numbers = all(get_effect(name).stage in (Stage.CAMERA, Stage.SENSOR) for name in cause.named)
    moved = moved_numbers(pixels, sized(cause)) if in_numbers else np.zeros(0, dtype=bool)
    in_numbers = bool(moved.any()) and float(np.max(np.abs(numbers[moved]))) > PLAIN
    with_numbers = [fold for fold in folds if len(fold.held_pixels.measured)]
    in_numbers = in_numbers and bool(with_numbers)
    blocks = [block for fold in (with_numbers if in_numbers else folds) for block in fold.held]
    judged = [b for b in blocks if in_numbers or b.scene == "stretch"] or blocks
    rows: list[Array] = []
    shown: list[Held] = []
    seen: list[Held] = []
    wrong: list[str] = []
    causes: dict[str, Cause] = {}
    tried = tuple(name for name in effects if name not in without)
    turns = {fold.name: fold for fold in folds if any(block is one for block in fold.held for one in judged)}
    for name, fold in turns.items():
        causes[name] = name_cause(tried, fold.rest, fold.rest_pixels, model, pairs=len(cause.named) > 1)
    sizes = {name: found.sized_as(cause.named) if known else sized(found) for name, found in causes.items()}
    if not in_numbers:
        judge.prepare(judged, sizes)
    for name, found in causes.items():
        fold = turns[name]
        rival = most_flexible_wrong(found, cause)
        wrong.append(rival[0] if rival else "none")
        if in_numbers:
            rows.append(_pixel_row(fold.held_pixels, found, rival))
            seen += [_unmoved(block, sized(found)) for block in fold.held]
        else:
            own = [pair for pair in zip(fold.held, fold.whole, strict=True) if any(pair[0] is one for one in judged)]
            shown += [hold_out(block, sizes[name], rival, judge, whole) for block, whole in own]
    rows += [one.squares for one in shown]
    best = tuple(one for one in seen if one.block.scene == "stretch") or tuple(seen)
    fresh = bool(judge.looks) and any(on_shapes(chosen) for chosen in sizes.values())
    shrinkage = _summarise(np.stack(rows), judged, wrong, in_numbers, fresh)
    named = tuple(tuple(name for name, _ in chosen) for chosen in sizes.values())
    return Measured(shrinkage.model_copy(update={"named_without": named}), tuple(shown), best)


def most_flexible_wrong(found: Cause, cause: Cause) -> Sized | None:
    """Of the effects that are not named nor declared inseparable from it, the one that explains most at its best."""
    taken = {other for name in cause.named for other in group_of(name)}
    wrong = [
        e
        for name, e in found.evidence.items()
        if name not in (*NOT_EFFECTS, *taken) and not get_effect(name).random_repeats
    ]
    best = max(wrong, key=lambda e: e.best, default=None)
    return None if best is None else (best.name, best.size)


def _summarise(rows: Array, judged: Sequence[Block], wrong: list[str], in_numbers: bool, fresh: bool) -> Shrinkage:
    everything = rows[:, -1]
    unit = 1.0 if in_numbers else 1e3
    values = unit * np.sqrt(np.mean(everything, axis=0))
    regions = []
    for number, region in enumerate(REGIONS[:-1] if not in_numbers else ()):
        own = rows[:, number][np.isfinite(rows[:, number]).all(axis=1)]
        if len(own):
            before, after, floor, _ = unit * np.sqrt(np.mean(own, axis=0))
            regions.append(
                RegionShrinkage(
                    region=region, before=before, after=after, noise_floor=min(floor, after), repeats=floor,
                    fraction=fraction_of(own), interval_90=interval_of(own),
                )
            )  # fmt: skip
    return Shrinkage(
        held_out=tuple(sorted(capture for block in judged for capture in block.captures)),
        before=float(values[0]),
        after=float(values[1]),
        noise_floor=float(min(values[1:3])),
        repeats=float(values[2]),
        fraction=fraction_of(everything),
        interval_90=interval_of(everything),
        unit="standard deviations" if in_numbers else "mm",
        simulated_afresh=fresh and not in_numbers,
        control=Control(
            effects=tuple(wrong),
            after=float(values[3]),
            fraction=fraction_of(everything[:, [0, 3, 2, 3]]),
        ),
        regions=tuple(regions),
    )


def hold_out(
    block: Block, effects: Sequence[Sized], rival: Sized | None, judge: Judge, whole: Block | None = None
) -> Held:
    """Judge a block with effects that were found without it, and with a wrong one.

    Args:
        block: what is held out.
        effects: found without it.
        rival: the wrong one.
        judge: simulates them.
        whole: the block with the repeats that are not held out, too, whose scatter is the floor; the block by default.
    """
    before = refit(block, np.zeros(len(block.owner)))
    after = refit(block, judge.response(block, effects))
    control = refit(block, block.metres(whitened(block, [rival] if rival else [])))
    repeats = block if whole is None else whole
    scattered = before.left if repeats is block else refit(repeats, np.zeros(len(repeats.owner))).left
    masks = region_of_cells(block.scene, cell_centres())
    rows = []
    for region in REGIONS:
        chosen = masks[region][block.cell]
        if not chosen.any():
            rows.append([np.nan] * 4)
            continue
        floor = repeat_squares(repeats, scattered, masks[region][repeats.cell])
        least = float(np.mean(before.variance[chosen])) if floor is None else floor
        squares = [float(np.mean(found.left[chosen] ** 2)) for found in (before, after, control)]
        rows.append([squares[0], squares[1], least, squares[2]])
    return Held(block, tuple(effects), np.array(rows), before.deviation, after.deviation, repeats.repeated)


def _unmoved(block: Block, effects: Sequence[Sized]) -> Held:
    """A block with effects that were found without it and that move no cloth: its parameters stay."""
    count = len(block.jacobian)
    return Held(block, tuple(effects), np.zeros((0, 4)), np.zeros(count), np.zeros(count))


def _pixel_row(pixels: PixelBlock, found: Cause, rival: Sized | None) -> Array:
    """The same of the numbers that a set shares, in squares of their standard deviations, [1, 4]."""

    explanations: list[list[Sized]] = [[], sized(found), [rival] if rival else []]
    before, after, control = (numbers_left(pixels, effects) for effects in explanations)
    return np.array([[before, after, 1.0, control]])


def moved_numbers(pixels: PixelBlock, effects: Sequence[Sized]) -> NDArray[np.bool_]:
    """Which of the shared numbers effects change by a standard deviation or more, bool [m]."""
    moved = np.zeros(len(pixels.measured), dtype=np.bool_)
    for name, size in effects:
        if not get_effect(name).random_repeats:
            moved |= np.abs(response_to(pixels.responses, name, size)) >= 1.0
    return moved


def numbers_left(pixels: PixelBlock, effects: Sequence[Sized]) -> float:
    """Mean square of the numbers that a set shares once effects are taken out, in standard deviations squared."""
    own = {name: size for name, size in effects if not get_effect(name).random_repeats}
    if len(own) == 2:  # what they do together is not the sum of what each does
        pixels = pixels_without_both(pixels, own)
    else:
        for name, size in own.items():
            pixels = pixels_without(pixels, name, size)
    return float(np.mean(pixels.measured**2))
