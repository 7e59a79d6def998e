from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from itertools import islice, zip_longest

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from simcore.errors import InputError
from trainer.dataset import (
    PairStream,
    Partition,
    PictureTable,
    Shown,
    batches,
    deal_shards,
    decode_heights,
    encode_heights,
    pair_up,
)
from trainer.split import split_materials

from .analytic import AnalyticSource

SOURCE = AnalyticSource(materials=12, jitters=2, size=32, shard_materials=2)


def _materials(stream: PairStream) -> list[int]:
    return [int(pair[3]) for pair in stream]


def _stream(**options: object) -> PairStream:
    return PairStream(SOURCE, SOURCE.table(), size=32, passes=1, **options)  # type: ignore[arg-type]


def test_a_pass_shows_every_picture_once() -> None:
    seen: Counter[bytes] = Counter()
    for heights, present, *_ in _stream(seed=3):
        for picture in heights[present]:
            seen[picture.numpy().tobytes()] += 1
    everything = SOURCE.read(SOURCE.table().row)
    assert seen == Counter(picture.numpy().tobytes() for picture in everything)


def test_orders_follow_the_seed_and_differ_between_passes() -> None:
    assert _materials(_stream(seed=1)) == _materials(_stream(seed=1)) != _materials(_stream(seed=2))
    endless = PairStream(SOURCE, SOURCE.table(), size=32, seed=1)
    pairs = [int(pair[3]) for pair in islice(endless, 48)]
    assert Counter(pairs[:24]) == Counter(pairs[24:]) and pairs[:24] != pairs[24:]


def test_ranks_share_the_shards_without_overlap() -> None:
    parts = [set(_materials(_stream(partition=Partition(rank, 3)))) for rank in range(3)]
    assert set.union(*parts) == set(range(12))
    assert sum(map(len, parts)) == 12


def test_shards_of_unequal_size_are_dealt_out_by_what_they_hold() -> None:
    """16 shards of 24 pictures behind 16 of two, as of two stores; of one size they go round."""
    home = np.concatenate([np.repeat(np.arange(16), 2), np.repeat(np.arange(16, 32), 24)])
    held = [int(np.isin(home, shards).sum()) for shards in deal_shards(home, 8)]
    assert held == [52] * 8
    assert [list(shards) for shards in deal_shards(np.repeat(np.arange(7), 3), 3)] == [[0, 3, 6], [1, 4], [2, 5]]


@pytest.mark.parametrize("lanes", [1, 2, 3])
def test_scenes_in_different_shards_are_paired(lanes: int) -> None:
    table = SOURCE.table()
    scenes_apart = replace(table, shard=table.scene * 6 + table.material // 2)
    across_borders = replace(table, shard=table.row // 7)  # four pictures a material
    for split in (scenes_apart, across_borders):
        parts = [
            PairStream(SOURCE, split, size=32, passes=1, partition=Partition(lane, lanes), buffer_shards=1)
            for lane in range(lanes)
        ]
        pairs = [pair for part in parts for pair in part]
        assert Counter(int(pair[3]) for pair in pairs) == dict.fromkeys(range(12), 2)
        assert all(pair[1].all() for pair in pairs)


def test_more_loaders_than_shards_is_refused() -> None:
    with pytest.raises(InputError, match="7 loaders but only 6 shards") as caught:
        next(iter(_stream(partition=Partition(0, 7))))
    assert caught.value.code == "too_few_shards"


@pytest.mark.slow
def test_spawned_workers_read_the_same_pictures() -> None:
    here = Counter(int(m) for batch in batches(_stream(), 4) for m in batch.material)
    there = Counter(int(m) for batch in batches(_stream(), 4, workers=1) for m in batch.material)
    assert here == there


def test_pairs_join_scenes_of_one_material_and_tolerate_gaps() -> None:
    table = SOURCE.table()
    table = table.take(~((table.material == 3) & (table.scene == 1)) & ~((table.material == 4) & (table.row % 4 == 0)))
    pairs = pair_up(table, np.random.default_rng(0))
    used = pairs[pairs >= 0]
    assert sorted(used) == list(range(len(table)))
    for hanging, stretch in pairs:
        if hanging >= 0 and stretch >= 0:
            assert table.material[hanging] == table.material[stretch]
            assert (table.scene[hanging], table.scene[stretch]) == (0, 1)


def _pairs_by_looking_through_all(table: PictureTable, generator: np.random.Generator | None) -> list[tuple[int, ...]]:
    """What `pair_up` says, material after material."""
    pairs: list[tuple[int, ...]] = []
    for material in np.unique(table.material):
        columns = [np.flatnonzero((table.material == material) & (table.scene == scene)) for scene in (0, 1)]
        drawn = [c if generator is None else generator.permutation(c) for c in columns]
        pairs += zip_longest(*(column.tolist() for column in drawn), fillvalue=-1)
    return pairs


@pytest.mark.parametrize("drawn", [False, True])
def test_pairs_are_those_of_each_material_by_itself(drawn: bool) -> None:
    table = AnalyticSource(materials=7, jitters=5).table()
    rng = np.random.default_rng(2)
    table = table.take(rng.permutation(np.flatnonzero((table.material != 2) & (rng.random(len(table)) < 0.6))))
    table = replace(table, material=table.material * 1000)
    one, other = (np.random.default_rng(9) if drawn else None for _ in range(2))
    assert pair_up(table, one).tolist() == [list(pair) for pair in _pairs_by_looking_through_all(table, other)]
    assert pair_up(table.take(table.row < 0), one).shape == (0, 2)
    if one is not None and other is not None:
        assert one.integers(2**60) == other.integers(2**60)


@pytest.mark.parametrize("done", [0, 1, 5, 8, 9, 20])
def test_the_rest_of_a_stream_comes_as_it_would_have_come(done: int) -> None:
    """Within a pass of eight batches, at its end and in the passes behind it."""
    whole = PairStream(SOURCE, SOURCE.table(), size=32, passes=3, seed=4, buffer_shards=2)
    rest = PairStream(SOURCE, SOURCE.table(), size=32, passes=3, seed=4, buffer_shards=2, shown=Shown(done, 3))
    expected = list(whole)[3 * done :]
    assert len(expected) == 72 - 3 * done
    for ours, theirs in zip(rest, expected, strict=True):
        assert all(torch.equal(a, b) for a, b in zip(ours, theirs, strict=True))


@dataclass(frozen=True)
class NotingSource(AnalyticSource):
    """Analytic cloth; ``noted`` lists the rows that were read."""

    noted: list[int] = field(default_factory=list)

    def read(self, rows: NDArray[np.int64]) -> Tensor:
        self.noted.extend(rows.tolist())
        return super().read(rows)


def test_what_was_shown_is_not_read_again() -> None:
    source = NotingSource(12, 2, 32, shard_materials=2)
    stream = PairStream(source, source.table(), size=32, passes=1, shown=Shown(5, 4))
    assert len(list(stream)) == 4 and len(source.noted) == 8


@pytest.mark.parametrize("done", range(8))
def test_a_new_loader_s_workers_take_the_places_of_whose_turn_it_is(done: int) -> None:
    """Three workers, batches of two pairs, dealt out in turn."""
    turns = [number % 3 for number in range(20)]
    places = [Shown(done, 2).of_worker(worker, 3) for worker in range(3)]
    assert [lane for lane, _ in places] == turns[done : done + 3]
    assert all(pairs == 2 * turns[:done].count(lane) for lane, pairs in places)


@pytest.mark.slow
def test_the_rest_comes_from_several_loading_processes_as_from_the_same_before() -> None:
    whole = PairStream(SOURCE, SOURCE.table(), size=32, seed=4)
    rest = PairStream(SOURCE, SOURCE.table(), size=32, seed=4, shown=Shown(5, 3))
    expected = list(islice(batches(whole, 3, workers=2), 9))[5:]
    for ours, theirs in zip(batches(rest, 3, workers=2), expected, strict=False):
        assert all(torch.equal(a, b) for a, b in zip(ours, theirs, strict=True))


def test_cache_gives_the_same_pictures() -> None:
    cached = PairStream(SOURCE, SOURCE.table(), size=16, passes=2, shuffled=False)
    uncached = PairStream(SOURCE, SOURCE.table(), size=16, passes=2, shuffled=False, cache_bytes=0)
    assert all(torch.equal(a[0], b[0]) for a, b in zip(cached, uncached, strict=True))


def test_heights_survive_their_code() -> None:
    heights = torch.tensor([[[-0.0123, 0.0], [0.25, 0.00004]]])[:, None]
    assert torch.allclose(decode_heights(encode_heights(heights)), heights, atol=5.1e-5)


def test_split_is_by_material_reproducible_and_covers() -> None:
    materials = np.repeat(np.arange(100), 7)
    split = split_materials(materials, seed=5, train_share=0.8, calibration_share=0.1)
    assert [len(split.train), len(split.calibration), len(split.test)] == [80, 10, 10]
    assert sorted(np.concatenate([split.train, split.calibration, split.test])) == list(range(100))
    small = split_materials(np.arange(40), seed=5, train_share=0.8, calibration_share=0.1)
    assert [len(small.train), len(small.calibration), len(small.test)] == [28, 8, 4]  # the tested share is as asked
    again = split_materials(materials[::-1], seed=5, train_share=0.8, calibration_share=0.1)
    assert np.array_equal(split.test, again.test)
    with pytest.raises(InputError, match=r"pictures of 4 materials, at least 5 .*larger store") as caught:
        split_materials(np.repeat(np.arange(4), 3), seed=0, train_share=0.8, calibration_share=0.1)
    assert caught.value.code == "too_few_materials"
