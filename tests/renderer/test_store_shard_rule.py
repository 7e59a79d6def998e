"""Why a writer takes whole shards only: two writers of one shard lose rows, and nobody hears of it."""

from __future__ import annotations

import asyncio
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields
from pathlib import Path

import pytest
import zarr
from zarr.core.buffer import Buffer
from zarr.storage import LocalStore, WrapperStore

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
    """Two writers, each with its half of shard 0, through Zarr as it is: both have read the shard's object by the time
    either replaces it, as two tasks of half a shard each may.
    """
    both_have_read = asyncio.Barrier(2)
    rows = rows_of(LAYOUT, 0)

    class MeetingStore(WrapperStore[LocalStore]):
        async def set(self, key: str, value: Buffer) -> None:
            if key.startswith("depth/c/"):
                await asyncio.wait_for(both_have_read.wait(), timeout=30)
            await self._store.set(key, value)

    def write(simulations: slice) -> None:
        array = zarr.open_group(MeetingStore(LocalStore(place)), mode="r+")["depth"]
        part = slice(simulations.start * PICTURES, simulations.stop * PICTURES)
        array[part] = rows.depth[part]

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
