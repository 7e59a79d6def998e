"""Why a writer takes whole shards only: two writers of one shard lose rows, and nobody hears of it."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from renderer.store import ShardRows, Store, StoreWriter
from simcore.errors import StoreError
from tests.renderer.test_store import LAYOUT, make, rows_of

PICTURES = LAYOUT.pictures
HALVES = (slice(0, 2), slice(2, 4))
"""Simulations of the first shard that each of two writers would take."""


def half(rows: ShardRows, simulations: slice) -> ShardRows:
    """Rows of some of a shard's simulations."""
    numbers = range(4)[simulations]
    return ShardRows.concatenate([rows.simulation(number, PICTURES) for number in numbers])


def write_together(place: Path) -> None:
    """Two writers, each with its half of shard 0, which both have read before either writes."""
    both_have_read = threading.Barrier(2)
    rows = rows_of(LAYOUT, 0)

    def write(simulations: slice) -> None:
        array = StoreWriter.open(place)._group["depth"]
        first, last = simulations.start * PICTURES, simulations.stop * PICTURES
        whole = np.asarray(array[:8])  # what a shard's read-modify-write does inside Zarr
        whole[first:last] = rows.depth[first:last]
        both_have_read.wait(timeout=30)
        array[:8] = whole

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(write, HALVES))


def test_without_the_rule_rows_are_lost_silently(tmp_path: Path) -> None:
    make(tmp_path / "s.zarr", shards=())
    write_together(tmp_path / "s.zarr")
    kept = Store.open(tmp_path / "s.zarr").depth_counts(0).reshape(8, -1).any(axis=1)
    assert kept.sum() == 4, "one writer's rows overwrote the other's"


def test_the_rule_refuses_what_would_lose_them(tmp_path: Path) -> None:
    make(tmp_path / "s.zarr", shards=())
    rows = rows_of(LAYOUT, 0)
    for simulations in HALVES:
        with pytest.raises(StoreError) as raised:
            StoreWriter.open(tmp_path / "s.zarr").write_shard(0, half(rows, simulations))
        assert raised.value.code == "partial_shard"
    assert not Store.open(tmp_path / "s.zarr").complete.any()


def test_every_array_is_checked_for_wholeness(tmp_path: Path) -> None:
    writer = make(tmp_path / "s.zarr", shards=())
    rows = rows_of(LAYOUT, 0)
    for field in fields(ShardRows):
        short = ShardRows(**(vars(rows) | {field.name: getattr(rows, field.name)[:-1]}))
        with pytest.raises(StoreError, match=field.name):
            writer.write_shard(0, short)
    writer.write_shard(0, rows)


def test_one_task_s_shard_is_one_object_of_every_array(tmp_path: Path) -> None:
    """The layout itself keeps tasks apart: no object holds rows of two shards."""
    make(tmp_path / "s.zarr")
    store = Store.open(tmp_path / "s.zarr")
    for shard in range(store.shards):
        assert all(value is not None for value in store.stored_bytes(shard).values())
    objects = [path for path in (tmp_path / "s.zarr").rglob("*") if path.is_file() and path.name != "zarr.json"]
    assert len(objects) == store.shards * 13
