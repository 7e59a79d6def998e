"""Streams of training pictures out of shards, by material, rank and worker.

A *pair* is one picture of each scene of one material (either may be missing). Shards are shuffled, then pairs within a
few shards; whole shards belong to one rank and one worker, which opens the store itself. A material whose pictures lie
in several shards belongs to the first of them, so that its scenes are paired wherever they lie.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import DataLoader, IterableDataset, get_worker_info

from simcore.errors import DrapemeterError, InputError
from simcore.scenes import Scene
from trainer.preprocess import resize

SCENES: tuple[Scene, ...] = (Scene.HANGING, Scene.STRETCH)
"""Order of the scene axis everywhere in this package."""

HEIGHT_UNIT_M = 1e-4
"""Pictures are held as int16 heights in this unit."""

_STREAM = 2


@dataclass(frozen=True)
class PictureTable:
    """What is known of every usable picture before reading it; all arrays have one entry a picture.

    Attributes:
        row: row in the store, int64.
        shard: shard that holds it, int64.
        material: int64; fabrics of the same seven parameters are one material.
        scene: index into :data:`SCENES`, int64.
        parameters: the seven, SI, float64, shape [n, 7].
        inclination_deg: float64.
        jitter: int64.
    """

    row: NDArray[np.int64]
    shard: NDArray[np.int64]
    material: NDArray[np.int64]
    scene: NDArray[np.int64]
    parameters: NDArray[np.float64]
    inclination_deg: NDArray[np.float64]
    jitter: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.row)

    def take(self, keep: NDArray[np.bool_] | NDArray[np.int64]) -> PictureTable:
        """The table of some pictures.

        Args:
            keep: bool, shape [n], or indices, int64, shape [kept]; their order is that of the new table.
        """
        return PictureTable(**{name: getattr(self, name)[keep] for name in self.__dataclass_fields__})

    def of_materials(self, materials: NDArray[np.int64]) -> PictureTable:
        """The table of some materials.

        Args:
            materials: int64, shape [materials].
        """
        return self.take(np.isin(self.material, materials))

    def upright(self) -> PictureTable:
        """Without the tilted pictures.

        Raises:
            InputError: all are tilted.
        """
        upright = np.abs(self.inclination_deg) < 1e-6
        if len(upright) and not upright.any():
            raise InputError(
                "all pictures of the store are tilted: make one with an odd number of --inclinations",
                code="no_upright_pictures",
            )
        return self.take(upright)

    def material_parameters(self) -> NDArray[np.float64]:
        """One row of parameters a material, ordered by material, shape [materials, 7]."""
        _, first = np.unique(self.material, return_index=True)
        return np.asarray(self.parameters[first])


class PictureSource(Protocol):
    """Where pictures come from; must be picklable and cheap to copy to another process."""

    def table(self) -> PictureTable:
        """Every usable picture."""
        ...

    def read(self, rows: NDArray[np.int64]) -> Tensor:
        """Heights over the panel of rows of one shard, int16 in 0.1 mm, 0 = nothing known, shape [rows, H, W]."""
        ...


class Batch(NamedTuple):
    """Pairs, ready for augmentation.

    Attributes:
        pictures: heights [m], float32, shape [pairs, 2 scenes, 1, size, size]; zero where absent.
        present: bool, shape [pairs, 2 scenes].
        parameters: float64, SI, shape [pairs, 7].
        material: int64, shape [pairs].
    """

    pictures: Tensor
    present: Tensor
    parameters: Tensor
    material: Tensor


@dataclass(frozen=True)
class Partition:
    """This process's place among those that train together."""

    rank: int = 0
    world_size: int = 1


def decode_heights(codes: Tensor) -> Tensor:
    """Pictures [m] of int16 heights [..., H, W]: float32, shape [..., 1, H, W]."""
    return codes.to(torch.float32).mul_(HEIGHT_UNIT_M).unsqueeze(-3)


def encode_heights(pictures: Tensor) -> Tensor:
    """int16 heights [..., H, W] of pictures [m], shape [..., 1, H, W]: inverts :func:`decode_heights` to 0.05 mm."""
    return (pictures.squeeze(-3) / HEIGHT_UNIT_M).round().clamp(-(2**15), 2**15 - 1).to(torch.int16)


@dataclass(frozen=True)
class Shown:
    """How far an interrupted training had come in its stream.

    Attributes:
        batches: that it has had.
        pairs: in each of them.
    """

    batches: int = 0
    pairs: int = 1

    def of_worker(self, worker: int, workers: int) -> tuple[int, int]:
        """Whose lane a loader's worker goes on with, and how many of its pairs were shown.

        A loader asks its workers in turn, so that the first of a new one takes the place of whose turn it was.
        """
        lane = (worker + self.batches) % workers
        return lane, self.pairs * max(0, math.ceil((self.batches - lane) / workers))


Pair = tuple[Tensor, Tensor, Tensor, Tensor]
"""int16 heights [scenes, size, size], present [scenes], parameters [7], material."""


class PairStream(IterableDataset[Pair | DrapemeterError]):
    """Endless stream of pairs; each pass visits every picture of its shards once, in a new order.

    Args:
        source: the pictures.
        table: which of them.
        size: edge of the pictures handed out [pixel].
        seed: of all orders.
        partition: which shards.
        passes: number of passes; None = endless.
        shuffled: False keeps the order of the store.
        buffer_shards: shards whose pictures are mixed with each other.
        cache_bytes: pictures kept decoded and shrunk in memory after their first reading.
        shown: what is left out at the beginning, unread; the rest comes as it would have come behind it.
    """

    def __init__(
        self,
        source: PictureSource,
        table: PictureTable,
        *,
        size: int,
        seed: int = 0,
        partition: Partition = Partition(),
        passes: int | None = None,
        shuffled: bool = True,
        buffer_shards: int = 8,
        cache_bytes: int = 2_000_000_000,
        shown: Shown = Shown(),
    ) -> None:
        super().__init__()
        self.source, self.table, self.size, self.seed = source, table, size, seed
        self.partition, self.passes, self.shuffled = partition, passes, shuffled
        self.buffer_shards, self.cache_bytes, self.shown = buffer_shards, cache_bytes, shown
        self._home = home_shards(table)
        self._cache: dict[int, Tensor] = {}
        self._cached_bytes = 0

    def __iter__(self) -> Iterator[Pair | DrapemeterError]:
        """Pairs; in a loader's own process what fails is handed on, which PyTorch would turn into a traceback."""
        try:
            yield from self._passes()
        except DrapemeterError as error:
            if get_worker_info() is None:
                raise
            yield error

    def _passes(self) -> Iterator[Pair]:
        mine, lane, shown = self._my_shards()
        done = 0
        while self.passes is None or done < self.passes:
            generator = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(_STREAM, lane, done)))
            shards = generator.permutation(mine) if self.shuffled else mine
            for start in range(0, len(shards), self.buffer_shards):
                pairs = self._pairs(shards[start : start + self.buffer_shards], generator)
                yield from self._read_pairs(pairs[shown:])
                shown = max(0, shown - len(pairs))
            done += 1

    def _my_shards(self) -> tuple[NDArray[np.int64], int, int]:
        info = get_worker_info()
        workers = info.num_workers if info else 1
        worker, shown = self.shown.of_worker(info.id if info else 0, workers)
        lane, lanes = self.partition.rank * workers + worker, self.partition.world_size * workers
        check_lanes(self.table, lanes)
        return deal_shards(self._home, lanes)[lane], lane, shown

    def _pairs(self, shards: NDArray[np.int64], generator: np.random.Generator) -> NDArray[np.int64]:
        """The pairs of some shards in the order in which they are shown, as :func:`pair_up` gives them."""
        chosen = np.flatnonzero(np.isin(self._home, shards))
        pairs = pair_up(self.table.take(chosen), generator if self.shuffled else None)
        entries = np.where(pairs >= 0, chosen[pairs], -1)
        return entries[generator.permutation(len(entries))] if self.shuffled else entries

    def _read_pairs(self, pairs: NDArray[np.int64]) -> Iterator[Pair]:
        chosen = np.unique(pairs[pairs >= 0])
        pictures = dict(zip(chosen.tolist(), self._read(chosen), strict=True))
        for members in pairs.tolist():
            known = next(m for m in members if m >= 0)
            yield (
                torch.stack([pictures[m] if m >= 0 else self._nothing() for m in members]),
                torch.tensor([m >= 0 for m in members]),
                torch.from_numpy(self.table.parameters[known]),
                torch.tensor(self.table.material[known]),
            )

    def _nothing(self) -> Tensor:
        return torch.zeros((self.size, self.size), dtype=torch.int16)

    def _read(self, chosen: NDArray[np.int64]) -> list[Tensor]:
        """Heights of table entries, shrunk, in their order; from the cache where possible."""
        missing = np.array([c for c in chosen if int(c) not in self._cache], dtype=np.int64)
        fresh: dict[int, Tensor] = {}
        for shard in np.unique(self.table.shard[missing]):
            entries = missing[self.table.shard[missing] == shard]
            heights = self.source.read(self.table.row[entries])
            if heights.shape[-1] != self.size:
                heights = encode_heights(resize(decode_heights(heights), self.size))
            fresh.update(zip(entries.tolist(), heights, strict=True))
        result = [fresh[int(c)] if int(c) in fresh else self._cache[int(c)] for c in chosen]
        for entry, heights in fresh.items():
            size = heights.numel() * heights.element_size()
            if self._cached_bytes + size <= self.cache_bytes:
                self._cache[entry] = heights.clone()
                self._cached_bytes += size
        return result


def check_lanes(table: PictureTable, lanes: int) -> None:
    """Refuse more loaders (ranks times workers each) than shards.

    Raises:
        InputError: code ``too_few_shards``.
    """
    shards = len(np.unique(home_shards(table)))
    if shards < lanes:
        raise InputError(
            f"{lanes} loaders but only {shards} shards of training pictures to share: use fewer ranks or workers, or a "
            "store with smaller shards",
            code="too_few_shards",
        )


def deal_shards(home: NDArray[np.int64], lanes: int) -> list[NDArray[np.int64]]:
    """The shards of each lane (a loader of a rank), with about as many pictures: each has the same number of steps.

    The largest first, each to the lane that holds fewest; where all are of one size they go round.

    Args:
        home: the shard of each picture, int64 [n].
        lanes: how many.
    """
    shards, pictures = np.unique(home, return_counts=True)
    held = np.zeros(lanes, dtype=np.int64)
    lane = np.empty(len(shards), dtype=np.int64)
    for place in np.argsort(-pictures, kind="stable"):
        lane[place] = np.argmin(held)
        held[lane[place]] += pictures[place]
    return [shards[lane == number] for number in range(lanes)]


def home_shards(table: PictureTable) -> NDArray[np.int64]:
    """The shard that each picture is learnt from with, int64 [n]: the first that holds a picture of its material."""
    materials, inverse = np.unique(table.material, return_inverse=True)
    first = np.full(len(materials), np.iinfo(np.int64).max)
    np.minimum.at(first, inverse, table.shard)
    return np.asarray(first[inverse])


def pair_up(table: PictureTable, generator: np.random.Generator | None) -> NDArray[np.int64]:
    """Pairs of table entries, int64, shape [pairs, scenes], -1 = absent; every entry is in exactly one pair.

    With a generator the pictures of a material are matched at random across scenes, else in their order.
    """
    materials, place = np.unique(table.material, return_inverse=True)
    group = place * len(SCENES) + table.scene
    ends = np.cumsum(np.bincount(group, minlength=len(materials) * len(SCENES)))
    groups = np.split(np.argsort(group, kind="stable"), ends[:-1])
    pairs = [np.empty((0, len(SCENES)), dtype=np.int64)]
    for start in range(0, len(groups), len(SCENES)):
        entries = groups[start : start + len(SCENES)]
        columns = [generator.permutation(column) for column in entries] if generator is not None else entries
        block = np.full((max(map(len, columns)), len(SCENES)), -1, dtype=np.int64)
        for scene, column in enumerate(columns):
            block[: len(column), scene] = column
        pairs.append(block)
    return np.concatenate(pairs)


def _collate(samples: list[Pair | DrapemeterError]) -> Batch | DrapemeterError:
    failed = next((sample for sample in samples if isinstance(sample, DrapemeterError)), None)
    if failed is not None:
        return failed
    codes, present, parameters, material = (torch.stack(column) for column in zip(*samples, strict=True))
    return Batch(decode_heights(codes), present, parameters, material)


def batches(stream: PairStream, batch_pairs: int, workers: int = 0) -> Iterator[Batch]:
    """Batches of a stream, read in this process or by spawned workers."""
    loader = DataLoader(
        stream,
        batch_size=batch_pairs,
        num_workers=workers,
        collate_fn=_collate,
        multiprocessing_context="spawn" if workers else None,
    )
    for batch in loader:
        if isinstance(batch, DrapemeterError):
            raise batch
        yield batch
