"""The paper's network: ResNet-18 trunk, self-attention, max and average pooling, fusion over scenes, regressor.

Source: Rodriguez-Pardo et al. 2023, section "Neural Network Architecture".
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from trainer.config import NetworkConfig
from trainer.trunk import ResNet18Trunk, SelfAttention

OUTPUTS = 6
"""Log-parameters, standardised, in the order of ``simcore.parameters.ESTIMATED_NAMES``."""


class Features(NamedTuple):
    """``maximum`` and ``mean``, float32, of single pictures, shape [pictures, channels], or by scene, shape
    [samples, scenes, channels].
    """

    maximum: Tensor
    mean: Tensor


class Prediction(NamedTuple):
    """``mean`` and ``log_spread`` of the standardised targets, float32, shape [samples, 6]."""

    mean: Tensor
    log_spread: Tensor


def fuse(features: Features, present: Tensor) -> Tensor:
    """Fuse over scenes: the maximum of the max-pooled, the mean of the average-pooled features (paper, "Fusion").

    Args:
        features: each float32, shape [samples, scenes, channels]; what is absent is ignored.
        present: bool, shape [samples, scenes]; at least one scene a sample.

    Returns:
        float32, shape [samples, 2 * channels].
    """
    there = present[:, :, None]
    maximum = features.maximum.masked_fill(~there, float("-inf")).amax(dim=1)
    mean = (features.mean * there).sum(dim=1) / there.sum(dim=1)
    return torch.cat([maximum, mean], dim=1)


class DrapeNetwork(nn.Module):
    """From pictures by scene and density to the standardised log-parameters and their spread.

    Without ``average_pooling`` the mean half of the features is zero (the ablation's simpler network); without
    ``use_density`` the density is replaced by zero, its mean.
    """

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.config = config
        self.trunk = ResNet18Trunk(config.channels, config.trunk_width)
        self.attention = SelfAttention(self.trunk.channels) if config.attention else nn.Identity()
        width = 2 * self.trunk.channels + 1
        layers: list[nn.Module] = [nn.Dropout(config.dropout)]
        for hidden in config.hidden:
            layers += [nn.Linear(width, hidden), nn.ReLU()]
            width = hidden
        self.regressor = nn.Sequential(*layers, nn.Linear(width, OUTPUTS))
        self.spread = nn.Sequential(nn.Linear(2 * self.trunk.channels + 1, 32), nn.ReLU(), nn.Linear(32, OUTPUTS))

    @property
    def feature_channels(self) -> int:
        """Channels of each pooled feature vector."""
        return self.trunk.channels

    def feature_map(self, images: Tensor) -> Tensor:
        """Last feature map behind the attention, shape [pictures, channels, h, w]."""
        result: Tensor = self.attention(self.trunk(images))
        return result

    def pool(self, feature_map: Tensor) -> Features:
        """Max and average pooling of a feature map."""
        mean = feature_map.mean(dim=(2, 3))
        return Features(feature_map.amax(dim=(2, 3)), mean if self.config.average_pooling else torch.zeros_like(mean))

    def extract(self, images: Tensor) -> Features:
        """The feature extractor.

        Args:
            images: float32, shape [pictures, channels, size, size], from ``trainer.preprocess.network_images``.
        """
        return self.pool(self.feature_map(images))

    def extract_by_scene(self, images: Tensor, present: Tensor) -> Features:
        """Features in the place of each picture, float32, shape [samples, scenes, channels]; zero where there is none.

        Args:
            images: as for :meth:`extract`, of the pictures that are there alone, in the order of ``present``.
            present: bool, shape [samples, scenes].
        """
        found = self.extract(images)
        shape = (*present.shape, self.feature_channels)
        return Features(*(f.new_zeros(shape).index_put((present,), f) for f in found))

    def regress(self, fused: Tensor, density: Tensor) -> Prediction:
        """The parameter regressor.

        Args:
            fused: from :func:`fuse`, shape [samples, 2 * channels].
            density: standardised log-density, float32, shape [samples].

        The spread is learnt on detached features, so that the mean is the plain least-squares regressor of the paper.
        """
        scalar = density[:, None] if self.config.use_density else torch.zeros_like(density[:, None])
        joined = torch.cat([fused, scalar], dim=1)
        return Prediction(self.regressor(joined), self.spread(joined.detach()).clamp(-4.0, 2.0))
