"""The light of the shaded pictures: white Lambertian cloth, one directional light, soft ambient light."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simcore.errors import InputError


@dataclass(frozen=True)
class Light:
    """Radiance of cloth with unit normal n under light from l: albedo * (ambient + direct * max(0, n.l)).

    Attributes:
        azimuth_deg: where the light comes from, to the camera's right of the optical axis [degree]. Wrinkles of the
            ``stretch`` scene run from the upper left to the lower right: light along them would hide them.
        elevation_deg: and above it [degree].
        direct: irradiance of the directional light over pi, where it falls square on the cloth.
        ambient: the same of the ambient light, from all sides.
        albedo: share of the light that the cloth sends back.
    """

    azimuth_deg: float = 45.0
    elevation_deg: float = 30.0
    direct: float = 0.80
    ambient: float = 0.15
    albedo: float = 0.9

    def __post_init__(self) -> None:
        least, most = min(self.direct, self.ambient, self.albedo), self.albedo * (self.direct + self.ambient)
        if not (least >= 0.0 and most <= 1.0 and math.isfinite(self.azimuth_deg + self.elevation_deg)):
            raise InputError(
                "light is negative, from nowhere or bright enough to saturate white cloth: give finite angles, shares "
                "of 0 or more, and albedo (direct + ambient) of at most 1",
                code="light",
            )

    @property
    def towards(self) -> NDArray[np.float64]:
        """Unit vector from the cloth to the light, camera frame (x right, y down, z forward), float64 [3]."""
        azimuth, elevation = math.radians(self.azimuth_deg), math.radians(self.elevation_deg)
        return np.array(
            [math.sin(azimuth) * math.cos(elevation), -math.sin(elevation), -math.cos(azimuth) * math.cos(elevation)]
        )

    def radiance(self, normals: NDArray[np.float32]) -> NDArray[np.float64]:
        """Linear radiance from 0 to 1 of cloth with these unit normals (camera frame), shape [..., 3] -> [...]."""
        facing = np.maximum(0.0, normals.astype(np.float64) @ self.towards)
        return self.albedo * (self.ambient + self.direct * facing)


def encode_srgb(linear: NDArray[np.float64]) -> NDArray[np.uint8]:
    """8-bit sRGB values of linear radiance from 0 to 1 (IEC 61966-2-1), same shape."""
    clipped = np.clip(linear, 0.0, 1.0)
    encoded = np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1.0 / 2.4) - 0.055)
    return np.rint(encoded * 255.0).astype(np.uint8)
