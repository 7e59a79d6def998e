"""Shrinkage of what camera and sensor change, in millimetres of depth as the picture shows them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from diagnosis.afresh.fresh import FreshLook, Sized, with_effects
from diagnosis.gap.regions import REGIONS, region_of_cells
from diagnosis.measurement.reference import cell_centres
from diagnosis.report import SeenDepth, SeenRegion
from diagnosis.shrinkage.held_out import Held
from diagnosis.shrinkage.shares import root_mean_squares, share_with_floors
from diagnosis.tasks.fabric_task import CaptureResult
from renderer.sensor import SensorModel

Picture = NDArray[np.float32]


def seen_depth(held: Sequence[Held], looks: Mapping[str, FreshLook]) -> SeenDepth:
    """Depth of captures against simulations without and with what was found without them, pixel by pixel.

    Over the cloth and the strip of the panel round it, the panel's own shift and tilt included, and region by region;
    parameters as they are stated. Noise of pixels is part of it, before and after alike. The floor is half of what
    repeats differ by, squared.
    """
    tallies = {region: _Tally() for region in REGIONS}
    for one in held:
        look = looks[one.block.fabric]
        own = [c for c in look.result.captures if c.id in one.block.captures]
        depths = {c.id: c.depth for c in look.result.task.captures}
        masks = region_of_cells(one.block.scene, cell_centres())
        for tally in tallies.values():
            tally.begin()
        for number, capture in enumerate(own):
            depth = depths[capture.id]
            plain, changed = look.picture(capture, ()), seen(look, capture, one.effects)
            alike = [depths[other.id] for other in own[:number] if seen_alike(look, capture, other)]
            for region, tally in tallies.items():
                shown = capture.reference.cell >= 0
                shown &= masks[region][capture.reference.cell]
                tally.add(depth, plain, changed, alike, shown)
        for tally in tallies.values():
            tally.end()
    regions = tuple(
        SeenRegion(region=region, **tallies[region].measured()) for region in REGIONS[:-1] if tallies[region].before
    )
    whole = tallies["all"]
    return SeenDepth(**whole.measured(), captures=len(whole.before), regions=regions)


@dataclass
class _Tally:
    """Mean squares of one region [m²]: of captures, of pairs of repeats, and by what was held out together."""

    before: list[float] = field(default_factory=list)
    after: list[float] = field(default_factory=list)
    floor: list[float] = field(default_factory=list)
    rows: list[tuple[float, float, float | None]] = field(default_factory=list)
    _first: tuple[int, int] = (0, 0)

    def begin(self) -> None:
        """What follows is held out together."""
        self._first = len(self.before), len(self.floor)

    def add(
        self, depth: Picture, plain: Picture, changed: Picture, alike: Sequence[Picture], shown: NDArray[np.bool_]
    ) -> None:
        """A capture, simulated without and with effects, and repeats that were seen alike; nothing where none shows."""
        squares = [_square(depth, other, shown) for other in (plain, changed)]
        if not np.isfinite(squares).all():
            return
        self.before.append(squares[0])
        self.after.append(squares[1])
        between = [0.5 * _square(depth, other, shown) for other in alike]
        self.floor += [square for square in between if np.isfinite(square)]

    def end(self) -> None:
        """What was held out together is complete."""
        before, floor = self.before[self._first[0] :], self.floor[self._first[1] :]
        if before:
            after = self.after[self._first[0] :]
            self.rows.append((_mean(before), _mean(after), _mean(floor) if floor else None))

    def measured(self) -> dict[str, Any]:
        """Root mean squares [mm], and the share that is closed."""
        fraction, interval = share_with_floors(self.rows, root_mean_squares)
        return {
            "before": 1e3 * float(np.sqrt(_mean(self.before))),
            "after": 1e3 * float(np.sqrt(_mean(self.after))),
            "noise_floor": 1e3 * float(np.sqrt(_mean(self.floor))) if self.floor else None,
            "fraction": fraction,
            "interval_90": interval,
        }


def seen_alike(look: FreshLook, capture: CaptureResult, other: CaptureResult) -> bool:
    """Two repeats were put up and seen alike, so that their pixels can be compared."""
    return look.scene_of(capture) == look.scene_of(other)


def seen(look: FreshLook, capture: CaptureResult, effects: Sequence[Sized]) -> Picture:
    """The simulation with effects on, read by the sensor without what is a matter of chance."""
    scene = with_effects(look.scene_of(capture), effects)
    sensor = SensorModel(
        depth_scale=scene.sensor.depth_scale,
        depth_bias_m=scene.sensor.depth_bias_m,
        smoothing_px=scene.sensor.smoothing_px,
        filter_px=scene.sensor.filter_px,
    )
    return sensor.apply(look.picture(capture, effects), np.random.default_rng(0), camera=scene.camera)


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values))


def _square(one: Picture, other: Picture, shown: NDArray[np.bool_]) -> float:
    """Mean square of the difference where both have data [m²]; NaN where they nowhere have."""
    both = shown & (one > 0.0) & (other > 0.0)
    if not both.any():
        return float("nan")
    return float(np.mean((one[both].astype(np.float64) - other[both]) ** 2))
