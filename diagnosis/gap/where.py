"""The gap row by row: scene by scene, by region of the cloth, by spatial kind and by stage."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.stats import chi2, false_discovery_control
from scipy.stats import f as f_distribution

from diagnosis.effect import Stage
from diagnosis.effects import get_effect
from diagnosis.gap.detection import HANGING_DEGREES
from diagnosis.gap.kinds import NUMBERS, kind_directions, numbers_of
from diagnosis.gap.regions import REGIONS, region_directions
from diagnosis.gap.stages import Lead, find_leads, no_numbers, probable_stage
from diagnosis.inference.block import Block, PixelBlock
from diagnosis.inference.cause import Cause
from diagnosis.inference.likelihood import LikelihoodModel
from diagnosis.measurement.reference import cell_centres
from diagnosis.report import Kind, Region, RegionGap

Array = NDArray[np.float64]
DEVIATIONS = "standard deviations"
MOST_SQUARE = 100.0
"""One shared number counts for no more than ten standard deviations, as in the test for a gap."""

LEAST_EXPLAINED = 0.02
"""An effect that takes a smaller share of a row's squared difference away explains nothing of it."""
STAGE_OF_NUMBERS: Mapping[Kind, Stage] = MappingProxyType({"pixels": Stage.SENSOR, "panel_plane": Stage.CAMERA})
"""Stage of a row of shared numbers of which no effect that was tried explains anything."""


def where_gaps(
    blocks: Sequence[Block], pixels: PixelBlock, cause: Cause, model: LikelihoodModel
) -> tuple[RegionGap, ...]:
    """Rows of all scenes; p-values adjusted for the number of all rows (Benjamini and Hochberg 1995).

    By region, and by the kinds ``low_order`` and ``folds`` [mm]: root mean square over the cells of all captures, that
    which repeats and stated uncertainties give by themselves, and the squares in units of the latter's covariance,
    referred to an F distribution in which a share of the dimensions counts. By the kinds ``pixels`` and
    ``panel_plane``: the numbers that the set shares [standard deviations], told with ``stretch`` where it was captured
    (the plane is that of all captures). By stage: see :func:`diagnosis.gap.stages.find_leads`.

    Args:
        blocks: of all fabrics and scenes.
        pixels: the numbers that the set shares.
        cause: found on them.
        model: of the likelihood.
    """
    scenes = sorted({block.scene for block in blocks})
    rows: list[RegionGap] = []
    for scene in scenes:
        own = [block for block in blocks if block.scene == scene]
        seen = pixels if scene == scenes[-1] else no_numbers(pixels)
        leads = find_leads(own, seen, cause, model, scatters=scene == scenes[-1])
        rows += _Scene(scene, own, seen, cause, model, leads).rows()
    adjusted: list[float] = list(false_discovery_control([row.p_adjusted for row in rows])) if rows else []
    return tuple(
        row.model_copy(update={"p_adjusted": min(1.0, float(p))}) for row, p in zip(rows, adjusted, strict=True)
    )


@dataclass(frozen=True)
class _Part:
    """What is compared of some measurements.

    Attributes:
        square: mean square difference, and the mean square that is expected without any effect, in the row's unit.
        p: not adjusted.
        measured: in units in which errors are independent and of size one, [d].
        responses: the same to each candidate, [candidates, d].
    """

    square: tuple[float, float]
    p: float
    measured: Array
    responses: Array


@dataclass(frozen=True)
class _Scene:
    """Captures of one scene and what may explain them."""

    name: str
    blocks: Sequence[Block]
    pixels: PixelBlock
    cause: Cause
    model: LikelihoodModel
    leads: Sequence[Lead]

    def rows(self) -> list[RegionGap]:
        """Of this scene, p-values not adjusted."""
        regions = [region_directions(block, cell_centres()) for block in self.blocks]
        kinds = [kind_directions(block, cell_centres()) for block in self.blocks]
        shapes: list[tuple[Literal["region", "kind"], Region, Kind, list[Array], list[int]]] = [
            ("region", region, "all", [own[region] for own in regions], [len(own[region]) for own in regions])
            for region in REGIONS
        ]
        cells = [sum(len(rows) for rows in own.values()) for own in kinds]
        two: tuple[Kind, Kind] = ("low_order", "folds")
        shapes += [("kind", "all", kind, [own[kind] for own in kinds], cells) for kind in two]
        found = []
        for by, region, kind, directions, counts in shapes:
            part = self._shape(directions, counts)
            if part is not None:
                found.append(self._row(by, region, kind, "mm", part))
        for kind in NUMBERS:
            part = self._numbers(kind)
            if part is not None:
                found.append(self._row("kind", "all", kind, DEVIATIONS, part))
        return found + [self._stage_row(lead) for lead in self.leads]

    def _shape(self, directions: Sequence[Array], counts: Sequence[int]) -> _Part | None:
        """Along some directions of each block [d, n], the mean taken over so many cells [mm]."""
        squares, measured, responses = np.zeros(2), [], []
        for block, along in zip(self.blocks, directions, strict=True):
            spread = along @ block.stated.factor
            covariance = spread @ spread.T
            whitening = solve_triangular(np.linalg.cholesky(covariance), spread, lower=True) if len(along) else spread
            squares += 1e6 * np.array([np.sum((spread @ block.stated.measured) ** 2), np.trace(covariance)])
            measured.append(whitening @ block.stated.measured)
            responses.append(_rows([whitening @ lead.on_block(block) for lead in self._candidates()], len(along)))
        whole = np.concatenate(measured)
        if not len(whole):
            return None
        degrees = self.model.degrees
        if self.name == "hanging":  # folds that were not found make heavy tails
            degrees = min(degrees, HANGING_DEGREES * len(self.blocks))
        share = max(len(whole) * self.model.dimension_share, 1.0)
        p = float(f_distribution.sf(float(np.mean(whole**2)), share, degrees))
        gap, floor = squares / sum(counts)
        return _Part((gap, floor), p, whole, np.concatenate(responses, axis=1))

    def _numbers(self, kind: Kind) -> _Part | None:
        """Of the shared numbers of a kind [standard deviations]."""
        chosen = numbers_of(kind, self.pixels.names)
        if not len(chosen):
            return None
        values = self.pixels.measured[chosen]
        p = float(chi2.sf(float(np.minimum(values**2, MOST_SQUARE).sum()) / 2.0, len(values)))
        responses = _rows([lead.on_numbers(self.pixels)[chosen] for lead in self._candidates()], len(chosen))
        return _Part((float(np.mean(values**2)), 1.0), p, values, responses)

    def _candidates(self) -> list[Lead]:
        """Named effects as they were found, then the leading effect of each stage."""
        named = [Lead(get_effect(n).stage, n, self.cause.size(n), 1.0, 0.0, 1.0) for n in self.cause.named]
        return [*named, *self.leads]

    def _row(self, by: Literal["region", "kind"], region: Region, kind: Kind, unit: str, part: _Part) -> RegionGap:
        """The stage is that of the candidate that takes most of the part's squared difference away; named is it only
        where there is more to explain than chance makes.
        """
        stage, effect, explained = STAGE_OF_NUMBERS.get(kind, probable_stage(self.cause)), None, 0.0
        gap, floor = np.sqrt(part.square)
        left = np.sum((part.measured - part.responses) ** 2, axis=1)
        taken = 1.0 - left / max(float(part.measured @ part.measured), 1e-12)
        best = int(np.argmax(taken)) if len(taken) else None
        if best is not None and taken[best] > LEAST_EXPLAINED:
            lead = self._candidates()[best]
            stage = lead.stage
            if gap > floor:
                effect, explained = lead.effect, float(taken[best])
        return RegionGap(
            scene=self.name,
            region=region,
            stage=stage.value,
            gap=float(gap),
            noise_floor=float(floor),
            p_adjusted=part.p,
            by=by,
            kind=kind,
            unit=unit,
            effect=effect,
            explained=explained,
        )

    def _stage_row(self, lead: Lead) -> RegionGap:
        """What it explains of the whole scene, shared numbers included."""
        share = self.model.dimension_share
        square, left = np.zeros(2)
        for block in self.blocks:
            square += share * float(np.sum(block.stated.measured**2))
            left += share * float(np.sum((block.stated.measured - lead.on_block(block)) ** 2))
        square += float(np.sum(self.pixels.measured**2))  # summed as what is left, so that nothing taken is nothing
        left += float(np.sum((self.pixels.measured - lead.on_numbers(self.pixels)) ** 2))
        return RegionGap(
            scene=self.name,
            region="all",
            stage=lead.stage.value,
            gap=lead.gap,
            noise_floor=lead.floor,
            p_adjusted=lead.p,
            by="stage",
            unit=DEVIATIONS,
            effect=lead.effect,
            explained=float(np.clip(1.0 - left / max(square, 1e-12), 0.0, 1.0)),
        )


def _rows(responses: Sequence[Array], length: int) -> Array:
    """One below the other, [candidates, length]; no candidate, no row."""
    return np.concatenate([np.zeros((0, length)), *(row[None] for row in responses)])
