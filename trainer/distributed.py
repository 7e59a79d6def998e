"""Data-parallel training over ``torch.distributed``; nothing happens in a partition of one."""

from __future__ import annotations

from collections.abc import Callable
from datetime import timedelta

import torch
import torch.distributed as dist
from torch import nn

from trainer.dataset import Partition

PATIENCE = timedelta(days=1)
"""So long the others wait for what rank 0 does alone, such as reading the held-out pictures before the first step: it
may take longer than the half hour which gloo waits for any message."""


def on_first(work: Callable[[], None], partition: Partition) -> None:
    """Do something on rank 0 alone while the others wait."""
    patient = dist.new_group(timeout=PATIENCE) if partition.world_size > 1 else None
    if partition.rank == 0:
        work()
    if patient is not None:
        dist.barrier(group=patient)
        dist.destroy_process_group(patient)


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
