"""Layers of the feature extractor: the ResNet-18 trunk and the self-attention layer."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from renderer.torchvision_import import import_torchvision


class ResNet18Trunk(nn.Module):
    """ResNet-18 (He et al. 2016) up to its last feature map, 32 times smaller than the input.

    At width 1 the keys and shapes of its state are torchvision's, apart from ``conv1``'s input channels and ``fc``.

    Args:
        in_channels: channels of the input.
        width: channels as a share of the usual 64-128-256-512.
    """

    def __init__(self, in_channels: int, width: float = 1.0) -> None:
        super().__init__()
        block = import_torchvision().models.resnet.BasicBlock
        stages = [max(8, 8 * round(planes * width / 8)) for planes in (64, 128, 256, 512)]
        self.channels = stages[-1]
        self.conv1 = nn.Conv2d(in_channels, stages[0], 7, stride=2, padding=3, bias=False)
        self.bn1 = nn.BatchNorm2d(stages[0])
        self.relu = nn.ReLU(inplace=True)
        self.maxpool = nn.MaxPool2d(3, stride=2, padding=1)
        before = stages[0]
        for index, planes in enumerate(stages):
            stride = 1 if index == 0 else 2
            shortcut: nn.Module | None = None
            if stride != 1 or before != planes:
                shortcut = nn.Sequential(
                    nn.Conv2d(before, planes, 1, stride=stride, bias=False), nn.BatchNorm2d(planes)
                )
            layer = nn.Sequential(block(before, planes, stride, shortcut), block(planes, planes))
            self.add_module(f"layer{index + 1}", layer)
            before = planes
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, mode="fan_out", nonlinearity="relu")

    def forward(self, images: Tensor) -> Tensor:
        """Last feature map, shape [pictures, channels, h / 32, w / 32]."""
        x: Tensor = self.maxpool(self.relu(self.bn1(self.conv1(images))))
        for index in range(4):
            x = self.get_submodule(f"layer{index + 1}")(x)
        return x


class SelfAttention(nn.Module):
    """Self-attention over the places of a feature map (Zhang et al. 2019, SAGAN, equations 1 to 3).

    The output is the input plus ``gamma`` times the attended values; ``gamma`` starts at 0, so a fresh layer changes
    nothing.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        inner = max(1, channels // 8)
        self.query = nn.Conv2d(channels, inner, 1, bias=False)
        self.key = nn.Conv2d(channels, inner, 1, bias=False)
        self.value = nn.Conv2d(channels, inner, 1, bias=False)
        self.out = nn.Conv2d(inner, channels, 1, bias=False)
        self.gamma = nn.Parameter(torch.zeros(1))

    def forward(self, x: Tensor) -> Tensor:
        """Same shape as ``x``, [pictures, channels, h, w]."""
        pictures, _, height, width = x.shape
        query = self.query(x).flatten(2)  # [pictures, inner, places]
        key = self.key(x).flatten(2)
        value = self.value(x).flatten(2)
        weights = torch.softmax(query.transpose(1, 2) @ key, dim=-1)  # [pictures, places, places]
        attended = (value @ weights.transpose(1, 2)).reshape(pictures, -1, height, width)
        result: Tensor = x + self.gamma * self.out(attended)
        return result
