"""Shrinkage of what camera and sensor change, in millimetres of depth as the picture shows them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from diagnosis.afresh.fresh import FreshLook, Sized, with_effects
from diagnosis.report import SeenDepth
from diagnosis.shrinkage.held_out import Held
from diagnosis.shrinkage.shares import root_mean_squares, share_with_floors
from diagnosis.tasks.fabric_task import CaptureResult
from renderer.sensor import SensorModel

Picture = NDArray[np.float32]


def seen_depth(held: Sequence[Held], looks: Mapping[str, FreshLook]) -> SeenDepth:
    """Depth of captures against simulations without and with what was found without them, pixel by pixel.

    Over the cloth and the strip of the panel round it, the panel's own shift and tilt included; parameters as they are
    stated. Noise of pixels is part of it, before and after alike. The floor is half of what repeats differ by, squared.
    """
    before: list[float] = []
    after: list[float] = []
    floor: list[float] = []
    rows: list[tuple[float, float, float | None]] = []
    for one in held:
        first, repeats = len(before), len(floor)
        look = looks[one.block.fabric]
        own = [c for c in look.result.captures if c.id in one.block.captures]
        depths = {c.id: c.depth for c in look.result.task.captures}
        for number, capture in enumerate(own):
            shown = capture.reference.cell >= 0
            before.append(_square(depths[capture.id], look.picture(capture, ()), shown))
            after.append(_square(depths[capture.id], _seen(look, capture, one.effects), shown))
            alike = [other for other in own[:number] if seen_alike(look, capture, other)]
            floor += [0.5 * _square(depths[capture.id], depths[other.id], shown) for other in alike]
        rows.append((_mean(before[first:]), _mean(after[first:]), _mean(floor[repeats:]) if floor[repeats:] else None))
    unit = 1e3
    fraction, interval = share_with_floors(rows, root_mean_squares)
    return SeenDepth(
        before=unit * float(np.sqrt(np.mean(before))),
        after=unit * float(np.sqrt(np.mean(after))),
        noise_floor=unit * float(np.sqrt(np.mean(floor))) if floor else None,
        fraction=fraction,
        interval_90=interval,
        captures=len(before),
    )


def seen_alike(look: FreshLook, capture: CaptureResult, other: CaptureResult) -> bool:
    """Two repeats were put up and seen alike, so that their pixels can be compared."""
    return look.scene_of(capture) == look.scene_of(other)


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values))


def _seen(look: FreshLook, capture: CaptureResult, effects: Sequence[Sized]) -> Picture:
    """The simulation with effects on, read by the sensor without what is a matter of chance."""
    scene = with_effects(look.scene_of(capture), effects)
    sensor = SensorModel(
        depth_scale=scene.sensor.depth_scale,
        depth_bias_m=scene.sensor.depth_bias_m,
        smoothing_px=scene.sensor.smoothing_px,
    )
    return sensor.apply(look.picture(capture, effects), np.random.default_rng(0), camera=scene.camera)


def _square(one: Picture, other: Picture, shown: NDArray[np.bool_]) -> float:
    """Mean square of the difference where both have data [m²]."""
    both = shown & (one > 0.0) & (other > 0.0)
    return float(np.mean((one[both].astype(np.float64) - other[both]) ** 2))
