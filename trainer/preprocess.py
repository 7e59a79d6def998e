"""From heights over the panel to the network's input; the same code in training and in prediction.

A *picture* is a float32 array [1, size, size]: height over the panel [m] in the canonical camera, 0 where nothing is
known. Augmentation works on pictures; everything here comes after it.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from trainer.config import NetworkConfig

FLOOR_M = 0.002
"""Cloth nearer to the panel than this looks like panel: a depth camera with a noise of a millimetre cannot tell."""

BINS = 1024
"""Levels of the histogram; enough that equalisation does not terrace a fold."""

LEAST_RANGE_M = 1e-4
"""A flatter cloth than this is flat: equalisation would only amplify rounding."""

HEIGHT_SCALE_M = 0.05
_CENTRE, _SCALE = 0.5, 0.3
_CLOTH_LEAST = 0.2


def resize(pictures: Tensor, size: int) -> Tensor:
    """Mean over whole blocks of pixels.

    Args:
        pictures: float32, shape [pictures, 1, source, source]; ``source`` a multiple of ``size``.
        size: edge of the result [pixel].
    """
    block = pictures.shape[-1] // size
    return pictures if block == 1 else functional.avg_pool2d(pictures, block)


def cloth_mask(pictures: Tensor) -> Tensor:
    """Where cloth stands off the panel by more than :data:`FLOOR_M`, over 3 x 3 pixels; bool, same shape."""
    return functional.avg_pool2d(pictures, 3, stride=1, padding=1, count_include_pad=False) > FLOOR_M


def equalise(height: Tensor, mask: Tensor) -> Tensor:
    """Histogram equalisation over the cloth.

    Each pixel becomes the share of the cloth that lies lower, counting half of its own histogram bin: a flat cloth is
    0.5 whatever its height. Deterministic; not differentiable and not meant to be.

    Args:
        height: [m], float32, shape [pictures, 1, H, W].
        mask: bool, same shape.

    Returns:
        float32 in (0, 1) on the cloth, 0 elsewhere, same shape.
    """
    pictures = height.shape[0]
    flat, cloth = height.reshape(pictures, -1), mask.reshape(pictures, -1)
    low = flat.masked_fill(~cloth, float("inf")).amin(dim=1, keepdim=True)
    high = flat.masked_fill(~cloth, float("-inf")).amax(dim=1, keepdim=True)
    spread = (high - low).clamp_min(LEAST_RANGE_M)
    bins = ((flat - low) / spread * (BINS - 1)).nan_to_num(0.0, 0.0, 0.0).round().clamp(0, BINS - 1).long()
    offset = torch.arange(pictures, device=height.device)[:, None] * BINS
    counts = torch.bincount((bins + offset)[cloth], minlength=pictures * BINS).reshape(pictures, BINS).to(flat.dtype)
    total = counts.sum(dim=1, keepdim=True).clamp_min(1)
    share = (counts.cumsum(dim=1) - 0.5 * counts) / total
    return (share.gather(1, bins) * cloth).reshape(height.shape)


def network_images(pictures: Tensor, config: NetworkConfig) -> Tensor:
    """The network's input.

    Args:
        pictures: float32, shape [pictures, 1, source, source].
        config: which channels, which size.

    Returns:
        float32, shape [pictures, channels, size, size], about zero mean and unit spread.
    """
    height = resize(pictures, config.input_size)
    mask = cloth_mask(height)
    channels = []
    if config.equalise:
        # The lowest cloth must not look like no cloth.
        lifted = equalise(height, mask) * (1.0 - _CLOTH_LEAST) + _CLOTH_LEAST * mask
        channels.append((lifted - _CENTRE) / _SCALE)
    if config.height_channel:
        channels.append(torch.where(mask, height, torch.zeros_like(height)) / HEIGHT_SCALE_M - 0.5)
    return torch.cat(channels, dim=1)
