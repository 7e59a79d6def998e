"""Several stores as one source of pictures."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest
import torch

from diagnosis.extension import SimulatorExtension
from simcore.errors import InputError
from tests.services.dataset_helpers import small_sweep
from tests.services.dataset_rows import made_up_store
from trainer.dataset import PictureTable
from trainer.held import held_in_training
from trainer.several_stores import SeveralStores, open_stores
from trainer.store_source import StoreSource


@pytest.fixture(scope="module")
def stores(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, ...]:
    """Coarse cells, fine ones with two of the same three fabrics, and fine ones with two others."""
    folder = tmp_path_factory.mktemp("stores")
    sweeps = (
        small_sweep(materials=3),
        small_sweep(materials=2, resolution_m=0.02),
        small_sweep(materials=2, resolution_m=0.02, seed=5),
    )
    return tuple(str(made_up_store(folder / f"{n}.zarr", *sweep)) for n, sweep in enumerate(sweeps))


def rows_of(table: PictureTable, shard: int) -> np.ndarray:
    return table.row[table.shard == shard]


def test_each_picture_is_that_of_its_store(stores: tuple[str, ...]) -> None:
    joined = SeveralStores(stores)
    own = [StoreSource(url) for url in stores]
    table, tables = joined.table(), [source.table() for source in own]
    assert len(table) == sum(map(len, tables))
    pictures = {int(row): picture for s in np.unique(table.shard) for row, picture in of_shard(joined, table, s)}
    rows, place = table.row.tolist(), 0
    for source, alone in zip(own, tables, strict=True):
        shown = {int(row): picture for s in np.unique(alone.shard) for row, picture in of_shard(source, alone, s)}
        for number, row in enumerate(alone.row.tolist()):
            assert torch.equal(pictures[rows[place + number]], shown[row])
            assert np.array_equal(table.parameters[place + number], alone.parameters[number])
        place += len(alone)


def of_shard(source: SeveralStores | StoreSource, table: PictureTable, shard: int) -> list[tuple[int, torch.Tensor]]:
    rows = rows_of(table, shard)
    return list(zip(rows.tolist(), source.read(rows), strict=True))


def test_no_shard_is_two_stores_and_one_fabric_is_one_material(stores: tuple[str, ...]) -> None:
    table = SeveralStores(stores).table()
    counts = [len(StoreSource(url).table()) for url in stores]
    of_store = np.repeat(np.arange(3), counts)
    for shard in np.unique(table.shard):
        assert len(np.unique(of_store[table.shard == shard])) == 1
    fabrics = np.unique(table.parameters, axis=0)
    assert len(np.unique(table.material)) == len(fabrics) == 5
    assert len(table.material_parameters()) == 5 and len(np.unique(table.material[of_store < 2])) == 3


def test_one_store_is_itself_and_several_travel_to_another_process(stores: tuple[str, ...]) -> None:
    assert isinstance(open_stores(stores[:1]), StoreSource)
    there = pickle.loads(pickle.dumps(open_stores(stores, "as_seen")))
    table = there.table()
    rows = rows_of(table, int(table.shard.max()))
    assert torch.equal(there.read(rows), SeveralStores(stores, "as_seen").read(rows))
    assert not torch.equal(there.read(rows), SeveralStores(stores).read(rows))


def test_the_record_names_every_store_and_how_its_magnets_held(tmp_path: Path, stores: tuple[str, ...]) -> None:
    held = SimulatorExtension(effects=(), pin_radius_m=0.0)
    points = str(made_up_store(tmp_path / "p.zarr", *small_sweep(materials=2, simulator=held)))
    said = SeveralStores([stores[0], points]).provenance()
    assert [one["resolution_m"] for one in said["configuration"]["merged"]] == [0.05, 0.05]
    assert held_in_training({"data": said}) == (0.0, 0.01)


def test_a_store_named_twice_is_refused(stores: tuple[str, ...]) -> None:
    with pytest.raises(InputError, match="named twice") as caught:
        open_stores([stores[0], stores[1], stores[0]])
    assert caught.value.code == "store_twice"
