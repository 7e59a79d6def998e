"""Two processes that train together."""

from __future__ import annotations

import time
from datetime import timedelta
from pathlib import Path

import pytest
import torch
import torch.distributed as dist
import torch.multiprocessing as processes
from torch import nn

from trainer.config import TrainConfig
from trainer.dataset import Partition
from trainer.distributed import average_gradients, average_statistics, broadcast_state, on_first
from trainer.train import pairs_of_batch, steps_of

from .analytic import AnalyticSource


def _rank(rank: int, meeting: str, out: str) -> None:
    """What rank 0 does alone takes longer than the others wait for any message."""
    dist.init_process_group("gloo", init_method=meeting, rank=rank, world_size=2, timeout=timedelta(seconds=3))
    partition = Partition(rank, 2)
    on_first(lambda: time.sleep(5), partition)
    torch.manual_seed(rank)
    network = nn.Sequential(nn.Linear(3, 2), nn.BatchNorm1d(2))
    broadcast_state(network, partition)
    start = network[0].weight.detach().clone()
    (network[0].weight.sum() * (rank + 1.0) + network[0].bias.sum() * 4.0 * rank).backward()
    average_gradients(network, partition)
    network[1].running_mean.fill_(2.0 * rank)
    average_statistics(network, partition)
    result = {
        "start": start,
        "weight_gradient": network[0].weight.grad,
        "bias_gradient": network[0].bias.grad,
        "running_mean": network[1].running_mean,
    }
    torch.save(result, f"{out}/{rank}.pt")
    dist.destroy_process_group()


@pytest.mark.slow
def test_ranks_start_alike_and_share_gradients_and_statistics(tmp_path: Path) -> None:
    processes.spawn(_rank, args=(f"file://{tmp_path}/meeting", str(tmp_path)), nprocs=2)
    first, second = (torch.load(tmp_path / f"{rank}.pt", weights_only=True) for rank in range(2))
    for name in first:
        assert torch.equal(first[name], second[name]), name
    assert torch.equal(first["weight_gradient"], torch.full((2, 3), 1.5))
    assert torch.equal(first["bias_gradient"], torch.full((2,), 2.0))
    assert torch.equal(first["running_mean"], torch.ones(2))


def test_one_rank_alone_does_nothing() -> None:
    layer = nn.Linear(2, 2)
    layer(torch.ones(1, 2)).sum().backward()
    before = layer.weight.grad.clone() if layer.weight.grad is not None else None
    done: list[int] = []
    on_first(lambda: done.append(1), Partition())
    assert done == [1]
    for step in (broadcast_state, average_gradients, average_statistics):
        step(layer, Partition())
    assert before is not None and layer.weight.grad is not None and torch.equal(layer.weight.grad, before)


def test_ranks_share_the_steps_of_an_epoch() -> None:
    table = AnalyticSource(materials=40, jitters=2).table()
    config = TrainConfig(epochs=3, batch_size=16)
    assert [steps_of(table, config, Partition(0, ranks)) for ranks in (1, 2, 5)] == [30, 15, 6]
    assert steps_of(table, TrainConfig(epochs=3, batch_size=16, pictures_per_epoch=32), Partition()) == 6


def test_an_epoch_shows_every_picture_of_a_store_with_one_scene_too() -> None:
    both = AnalyticSource(materials=40, jitters=2).table()
    one = both.take(both.scene == 1)
    config = TrainConfig(epochs=1, batch_size=16)
    assert (pairs_of_batch(both, config), pairs_of_batch(one, config)) == (8, 16)
    assert steps_of(one, config, Partition()) * pairs_of_batch(one, config) == len(one)
