"""Structural similarity (Wang et al. 2004) and its multi-scale form (Wang et al. 2003), as distances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from metric.backends import Channel
from metric.pairwise import pairwise_table
from metric.render import DrapeRender, check_same_size
from simcore.errors import InputError

_SIGMA = 1.5
_RADIUS = 5  # 11 x 11 window
_C1, _C2 = 0.01**2, 0.03**2  # of a range of 1
_SCALE_WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)

Image = NDArray[np.float64]


@dataclass(frozen=True)
class Moments:
    """A grey picture in [0, 1] with its local mean and variance under the Gaussian window, each [H, W]."""

    image: Image
    mean: Image
    variance: Image


class Ssim:
    """1 - SSIM: mean over all 11 x 11 Gaussian windows that lie inside the picture."""

    name = "ssim"
    channel = Channel.SHADED
    unit = ""
    fingerprint = "ssim/1"
    scales = 1

    def features(self, renders: Sequence[DrapeRender]) -> list[list[Moments]]:
        """Local moments at each scale."""
        check_same_size([r.need_shaded().shape for r in renders])
        smallest = (2 * _RADIUS + 1) * 2 ** (self.scales - 1)
        found = []
        for render in renders:
            image = grey(render.need_shaded())
            if min(image.shape) < smallest:
                raise InputError(f"{self.name} needs pictures of at least {smallest} pixels a side", code="image_size")
            pyramid = []
            for scale in range(self.scales):
                image = halve(image) if scale else image
                pyramid.append(_moments(image))
            found.append(pyramid)
        return found

    def table(self, a: Sequence[list[Moments]], b: Sequence[list[Moments]]) -> NDArray[np.float64]:
        """1 - similarity of every pair, shape [len(a), len(b)]."""
        check_same_size([f[0].image.shape for f in (*a, *b)])
        return pairwise_table(a, b, lambda x, y: 1.0 - self._similarity(x, y))

    def _similarity(self, x: list[Moments], y: list[Moments]) -> float:
        _structure, whole = _ssim(x[0], y[0])
        return whole


class MsSsim(Ssim):
    """1 - MS-SSIM over five scales with the published weights; negative contrast terms count as 0."""

    name = "ms-ssim"
    fingerprint = "ms-ssim/1"
    scales = len(_SCALE_WEIGHTS)

    def _similarity(self, x: list[Moments], y: list[Moments]) -> float:
        product = 1.0
        for scale, weight in enumerate(_SCALE_WEIGHTS):
            structure, whole = _ssim(x[scale], y[scale])
            value = whole if scale == self.scales - 1 else structure
            product *= max(value, 0.0) ** weight
        return product


def grey(picture: NDArray[np.uint8]) -> Image:
    """8-bit picture to grey in [0, 1], float64 [H, W]."""
    values = picture.astype(np.float64) / 255.0
    return values if values.ndim == 2 else values @ np.array([0.299, 0.587, 0.114])


def halve(image: Image) -> Image:
    """Mean of 2 x 2 blocks; an odd last row or column is dropped."""
    height, width = image.shape[0] // 2 * 2, image.shape[1] // 2 * 2
    blocks = image[:height, :width].reshape(height // 2, 2, width // 2, 2)
    halved: Image = blocks.mean(axis=(1, 3))
    return halved


def _window(image: Image) -> Image:
    """Gaussian mean of each 11 x 11 window inside the picture."""
    blurred: Image = gaussian_filter(image, _SIGMA, radius=_RADIUS)[_RADIUS:-_RADIUS, _RADIUS:-_RADIUS]
    return blurred


def _moments(image: Image) -> Moments:
    mean = _window(image)
    return Moments(image, mean, _window(image**2) - mean**2)


def _ssim(x: Moments, y: Moments) -> tuple[float, float]:
    """Mean contrast-structure term and mean SSIM."""
    covariance = _window(x.image * y.image) - x.mean * y.mean
    structure = (2.0 * covariance + _C2) / (x.variance + y.variance + _C2)
    luminance = (2.0 * x.mean * y.mean + _C1) / (x.mean**2 + y.mean**2 + _C1)
    return float(structure.mean()), float((structure * luminance).mean())
