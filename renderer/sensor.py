"""A depth camera as a chain of separate, seeded mechanisms."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike

from renderer.camera import Camera
from renderer.sensor_holes import Depth, add_flying_pixels, cast_shadow, drop_edges, drop_grazing, drop_readings
from renderer.sensor_noise import (
    add_range_noise,
    bias_depth,
    quantise_disparity,
    quantise_uniform,
    scale_depth,
    smooth_depth,
)
from simcore.errors import InputError


class Quantisation(StrEnum):
    """``uniform``: the same step at every depth. ``disparity``: steps grow as z²."""

    UNIFORM = "uniform"
    DISPARITY = "disparity"


@dataclass(frozen=True)
class SensorModel:
    """What the sensor adds to an ideal depth picture; everything off by default, and then nothing changes.

    Applied in this order, the way of the light first and the electronics last. Smoothing comes before the noise, so
    that ``range_noise_m`` is the noise that is seen in the picture, as a capture set states it.

    Attributes:
        shadow_baseline_m: projector's distance to the camera's right; its shadow has no data [m].
        grazing_limit_deg: surface turned further from the line of sight has no data [degree]; 90 = off.
        depth_scale: share added to every depth.
        depth_bias_m: added to every depth [m].
        flying_pixels: share of edge pixels that read between the two sides of the edge.
        smoothing_px: standard deviation of the optics' blur, before the noise [pixel].
        range_noise_m: standard deviation along z at ``at_m``, growing as z² [m].
        at_m: reference depth of noise and quantisation [m].
        filter_px: standard deviation of the blur by the sensor's own filter, after the noise [pixel].
        edge_dropout: share of edge pixels without data.
        dropout: share of all pixels without data.
        dropout_patch_px: size of the dropout's holes [pixel]; 0 = single pixels.
        quantisation_m: distance of neighbouring depth values at ``at_m`` [m].
        quantisation: ``uniform`` (as the capture sets at hand show) or ``disparity``.
        edge_jump_m: a larger step between neighbours is an edge [m].
    """

    shadow_baseline_m: float = 0.0
    grazing_limit_deg: float = 90.0
    depth_scale: float = 0.0
    depth_bias_m: float = 0.0
    flying_pixels: float = 0.0
    smoothing_px: float = 0.0
    range_noise_m: float = 0.0
    at_m: float = 0.9
    filter_px: float = 0.0
    edge_dropout: float = 0.0
    dropout: float = 0.0
    dropout_patch_px: float = 0.0
    quantisation_m: float = 0.0
    quantisation: str = Quantisation.UNIFORM
    edge_jump_m: float = 0.01

    def __post_init__(self) -> None:
        if self.quantisation not in tuple(Quantisation):
            raise InputError(
                f"unknown quantisation {self.quantisation!r}: choose {' or '.join(q.value for q in Quantisation)}",
                code="sensor_quantisation",
            )
        if not self.edge_jump_m > 0.0:
            raise InputError(f"edge jump {self.edge_jump_m} m must be positive", code="sensor_edge_jump")
        # One pass over a small picture: the mechanisms themselves check their magnitudes.
        self.apply(np.ones((2, 2), np.float32), np.random.default_rng(0), camera=Camera(2, 2, 2.0, 2.0, 0.5, 0.5))

    @property
    def off(self) -> bool:
        """Nothing is switched on: ``apply`` is the identity."""
        return (
            replace(self, at_m=0.9, dropout_patch_px=0.0, quantisation=Quantisation.UNIFORM, edge_jump_m=0.01)
            == IDEAL_SENSOR
        )

    def apply(self, depth: ArrayLike, rng: np.random.Generator, *, camera: Camera | None = None) -> Depth:
        """The picture that the sensor gives.

        Each random mechanism has a stream of its own, drawn from ``rng``: switching one on or off leaves the others'
        noise as it was.

        Args:
            depth: ideal z-depth [m], shape [H, W]; 0 = no data.
            rng: source of randomness; four numbers are drawn from it whatever is switched on.
            camera: needed by shadow and grazing loss.

        Returns:
            float32 [H, W], metres, 0 = no data.

        Raises:
            InputError: not a depth picture, a magnitude out of range, or the camera is needed and missing.
        """
        picture = np.asarray(depth, dtype=np.float32)
        if picture.ndim != 2 or not np.all(np.isfinite(picture)) or picture.min(initial=0.0) < 0.0:
            raise InputError(
                "a depth picture has shape [rows, columns], finite, not negative, 0 where there is no data",
                code="depth_invalid",
            )
        flying, noise, edge, holes = (np.random.default_rng(int(seed)) for seed in rng.integers(2**63, size=4))
        if self.shadow_baseline_m != 0.0 or self.grazing_limit_deg < 90.0:
            if camera is None:
                raise InputError("the sensor's shadow and grazing loss need the camera: pass camera=", code="camera")
            picture = cast_shadow(picture, camera, self.shadow_baseline_m)
            picture = drop_grazing(picture, camera, self.grazing_limit_deg)
        edge_lost = drop_edges(picture, self.edge_dropout, edge, self.edge_jump_m) == 0.0
        picture = bias_depth(scale_depth(picture, self.depth_scale), self.depth_bias_m)
        picture = add_flying_pixels(picture, self.flying_pixels, flying, self.edge_jump_m)
        picture = smooth_depth(picture, self.smoothing_px)
        picture = add_range_noise(picture, self.range_noise_m, self.at_m, noise)
        picture = smooth_depth(picture, self.filter_px)
        picture = drop_readings(picture, self.dropout, holes, self.dropout_patch_px)
        picture = np.where(edge_lost, np.float32(0.0), picture)
        if self.quantisation == Quantisation.DISPARITY:
            return quantise_disparity(picture, self.quantisation_m, self.at_m)
        return quantise_uniform(picture, self.quantisation_m)


IDEAL_SENSOR = SensorModel()

SR300_LIKE = SensorModel(
    shadow_baseline_m=0.05,
    grazing_limit_deg=80.0,
    flying_pixels=0.3,
    smoothing_px=0.6,
    range_noise_m=0.001,
    at_m=0.9,
    edge_dropout=0.15,
    dropout=0.005,
    dropout_patch_px=1.0,
    quantisation_m=0.000125,
)
"""A coded-light camera of the SR300's kind: 0.125 mm counts (Zabatani et al., PAMI 2020), 1 mm of noise at 0.9 m and
15 % of the pixels at edges lost as in the capture sets at hand; the rest are round numbers of the right size."""

SENSORS: dict[str, SensorModel] = {"ideal": IDEAL_SENSOR, "sr300": SR300_LIKE}


def named_sensor(name: str) -> SensorModel:
    """Sensor model by name.

    Raises:
        InputError: unknown name.
    """
    if name not in SENSORS:
        raise InputError(f"unknown sensor {name!r}: choose {' or '.join(SENSORS)}", code="sensor_unknown")
    return SENSORS[name]
