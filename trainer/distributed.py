"""Data-parallel training over ``torch.distributed``; nothing happens in a partition of one."""

from __future__ import annotations

import torch
import torch.distributed as dist
from torch import nn

from trainer.dataset import Partition


def broadcast_state(network: nn.Module, partition: Partition) -> None:
    """Give every rank the weights and statistics of rank 0."""
    if partition.world_size > 1:
        for tensor in network.state_dict().values():
            dist.broadcast(tensor, src=0)


def average_gradients(network: nn.Module, partition: Partition) -> None:
    """Replace each gradient by its mean over the ranks, in one message."""
    if partition.world_size == 1:
        return
    gradients = [p.grad for p in network.parameters() if p.grad is not None]
    flat = torch.cat([g.flatten() for g in gradients])
    dist.all_reduce(flat)
    flat /= partition.world_size
    start = 0
    for gradient in gradients:
        gradient.copy_(flat[start : start + gradient.numel()].view_as(gradient))
        start += gradient.numel()


def average_statistics(network: nn.Module, partition: Partition) -> None:
    """Replace the running statistics of batch normalisation by their mean over the ranks."""
    if partition.world_size > 1:
        for buffer in network.buffers():
            if buffer.is_floating_point():
                dist.all_reduce(buffer)
                buffer /= partition.world_size
