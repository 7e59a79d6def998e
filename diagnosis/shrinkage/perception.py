"""Shrinkage as people see it: LPIPS between shaded pictures of captures and of simulations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from diagnosis.afresh.fresh import FreshLook, Sized, with_effects
from diagnosis.report import Perceived
from diagnosis.shrinkage.held_out import Held
from diagnosis.shrinkage.seen_depth import seen_alike
from diagnosis.shrinkage.shares import means, share_with_floors
from metric.backends import get_backend
from metric.render import DrapeRender
from renderer.camera import Camera
from simcore.parameters import LIMITS, PARAMETER_NAMES, FabricParameters

SMOOTHING_PX = 2.5
"""A depth sensor's noise would drown every fold in the shading."""
LIGHT = (0.35, -0.6, -0.72)
"""Direction towards the light, camera frame: from above and a little from the side."""
MARGIN_PX = 12
FRAME_PX = 2


def perceived(held: Sequence[Held], looks: Mapping[str, FreshLook]) -> Perceived:
    """LPIPS of held-out captures from simulations without and with what was found, parameters refitted both times.

    Simulations are afresh and seen through the stated sensor; both pictures are smoothed alike and shaded. The floor is
    the distance between repeats.

    Raises:
        MissingResourceError: the network's weights are not here.
    """
    backend = get_backend("lpips")
    before: list[float] = []
    after: list[float] = []
    floor: list[float] = []
    blocks: list[tuple[float, float, float | None]] = []
    for one in held:
        first, repeats = len(before), len(floor)
        look = looks[one.block.fabric]
        own = [c for c in look.result.captures if c.id in one.block.captures]
        tasks = {c.id: c for c in look.result.task.captures}
        for number, capture in enumerate(own):
            scene = look.scene_of(capture)
            rows, columns = np.nonzero(capture.reference.cell >= 0)
            window = (
                slice(max(rows.min() - MARGIN_PX, 0), rows.max() + MARGIN_PX),
                slice(max(columns.min() - MARGIN_PX, 0), columns.max() + MARGIN_PX),
            )
            pictures = [tasks[capture.id].depth]
            cases: tuple[tuple[Sequence[Sized], NDArray[np.float64]], ...] = (
                ((), one.before),
                (one.effects, one.after),
            )
            for effects, deviation in cases:
                ideal = look.picture(capture, effects, refitted(look, deviation))
                seen = with_effects(scene, effects)
                pictures.append(seen.sensor.apply(ideal, np.random.default_rng(number), camera=seen.camera))
            pictures += [tasks[other.id].depth for other in own[:number] if seen_alike(look, capture, other)]
            # a frame of background: where cloth fills the window nothing else would say that black is black
            framed = [np.pad(shade(p, scene.camera)[window], FRAME_PX) for p in pictures]
            renders = [DrapeRender(shaded=picture, depth=None) for picture in framed]
            features = backend.features(renders)
            distance = backend.table(features[:1], features[1:])[0]
            before.append(distance[0])
            after.append(distance[1])
            floor += list(distance[2:])
        own_floor = float(np.mean(floor[repeats:])) if floor[repeats:] else None
        blocks.append((float(np.mean(before[first:])), float(np.mean(after[first:])), own_floor))
    fraction, interval = share_with_floors(blocks, means)
    return Perceived(
        before=float(np.mean(before)),
        after=float(np.mean(after)),
        noise_floor=float(np.mean(floor)) if floor else None,
        fraction=fraction,
        interval_90=interval,
        backend=backend.name,
        captures=len(before),
    )


def refitted(look: FreshLook, deviation: NDArray[np.float64]) -> FabricParameters:
    """A fabric moved by so many stated standard deviations of its parameters, [7], as far as there are such fabrics."""
    task = look.result.task
    moved = task.parameters.as_array() * np.exp(np.asarray(task.relative_sigma) * deviation)
    low, high = np.array([LIMITS[name] for name in PARAMETER_NAMES]).T
    return FabricParameters.from_array(np.clip(moved, low, high))


def shade(depth: NDArray[np.float32], camera: Camera) -> NDArray[np.uint8]:
    """Lambertian shading of a depth picture [m], smoothed; uint8 [H, W], 0 where there is no data."""
    from scipy import ndimage

    known = (depth > 0).astype(np.float64)
    weight = ndimage.gaussian_filter(known, SMOOTHING_PX)
    z = ndimage.gaussian_filter(depth.astype(np.float64), SMOOTHING_PX) / np.maximum(weight, 1e-6)
    down, across = np.gradient(z)
    normal = np.stack(
        [camera.fx * across / np.maximum(z, 1e-6), camera.fy * down / np.maximum(z, 1e-6), -np.ones_like(z)]
    )
    normal /= np.linalg.norm(normal, axis=0)
    light = np.asarray(LIGHT) / np.linalg.norm(LIGHT)
    bright = np.clip(np.tensordot(light, normal, axes=1), 0.0, 1.0)
    return np.asarray(np.where(weight > 0.2, 25.0 + 230.0 * bright, 0.0), dtype=np.uint8)
