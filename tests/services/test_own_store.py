"""Two sweeps that begin in one place at the same moment: of others, one is refused; of the same one, none."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from renderer import store_writer
from renderer.store import Store, StoreWriter
from renderer.store_format import array_specs
from services.dataset.configuration import SweepConfiguration
from services.dataset.shard import ShardTask
from services.dataset.sweep import prepare_store
from services.dataset.worker import ShardWorker
from simcore.errors import InputError, StoreError
from tests.services.dataset_helpers import small_sweep, write_without_ray

CONFIGURATION, FABRICS = small_sweep()
OTHER, _ = small_sweep(seed=5)
TASK = ShardTask(0, FABRICS.parameters([0, 0, 1]), {})


def lay_out(place: Path, configuration: SweepConfiguration) -> None:
    """As a sweep that has looked before anything was there."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(store_writer, "_refuse_occupied", lambda url, layout: None)
        StoreWriter.create(
            place,
            configuration.layout,
            configuration=configuration.model_dump(mode="json"),
            seed=configuration.seed,
            software_version=str(Store.open(place).stated["software_version"]),
        )


@pytest.fixture
def beaten(monkeypatch: pytest.MonkeyPatch) -> list[SweepConfiguration]:
    """Sweeps that are laid out over any that is being begun."""
    others: list[SweepConfiguration] = []
    create = StoreWriter.create

    def overtaken(url: str, *given: Any, **named: Any) -> None:
        create(url, *given, **named)
        monkeypatch.setattr(StoreWriter, "create", create)
        for other in others:
            lay_out(Path(url), other)

    monkeypatch.setattr(StoreWriter, "create", overtaken)
    return others


def test_a_sweep_over_which_another_was_laid_is_refused(beaten: list[SweepConfiguration], tmp_path: Path) -> None:
    beaten.append(OTHER)
    with pytest.raises(
        InputError, match=r"other settings \(seed\); resume it with its own, or choose another"
    ) as caught:
        prepare_store(str(tmp_path / "s.zarr"), CONFIGURATION, resume=False)
    assert caught.value.code == "store_configuration"


def test_two_drivers_of_one_sweep_do_all_of_it(beaten: list[SweepConfiguration], tmp_path: Path) -> None:
    beaten.append(CONFIGURATION)
    shards = prepare_store(str(tmp_path / "s.zarr"), CONFIGURATION, resume=False)
    assert shards == list(range(CONFIGURATION.layout.shards))
    list(ShardWorker(str(tmp_path / "s.zarr"), CONFIGURATION).run(TASK))
    assert Store.open(tmp_path / "s.zarr").complete.tolist() == [True] + [False] * (len(shards) - 1)


def test_a_worker_writes_into_no_other_sweep(tmp_path: Path) -> None:
    prepare_store(str(tmp_path / "s.zarr"), CONFIGURATION, resume=False)
    lay_out(tmp_path / "s.zarr", OTHER)
    with pytest.raises(InputError, match=r"other settings \(seed\)") as caught:
        list(ShardWorker(str(tmp_path / "s.zarr"), CONFIGURATION).run(TASK))
    assert caught.value.code == "store_configuration"
    assert not Store.open(tmp_path / "s.zarr").complete.any()


@pytest.mark.parametrize("settings", [{"simulations_per_shard": 4}, {"materials": 9}, {"inclinations": 3}])
def test_a_worker_writes_into_no_store_of_two_sweeps(settings: dict[str, int], tmp_path: Path) -> None:
    """They laid out an array after the other each, and one came last with what the store states."""
    prepare_store(str(tmp_path / "s.zarr"), CONFIGURATION, resume=False)
    stated = (tmp_path / "s.zarr" / "zarr.json").read_bytes()
    lay_out(tmp_path / "s.zarr", small_sweep(**settings)[0])
    (tmp_path / "s.zarr" / "zarr.json").write_bytes(stated)
    with pytest.raises(StoreError, match="two sweeps laid it out at the same moment; remove it, and start") as caught:
        list(ShardWorker(str(tmp_path / "s.zarr"), CONFIGURATION).run(TASK))
    assert caught.value.code == "store_layout"


def test_an_array_that_another_driver_lays_out_just_now_is_no_reason(tmp_path: Path) -> None:
    """The store's arrays come back; what needs one that does not says so."""
    store = write_without_ray(tmp_path / "s.zarr", *small_sweep(materials=2))
    configuration, fabrics = small_sweep(materials=2)
    (store / array_specs(configuration.layout)[0].name / "zarr.json").unlink()
    worker = ShardWorker(str(store), configuration)
    assert [word.found for word in worker.run(ShardTask(1, fabrics.parameters([1]), {}))] == [True]  # type: ignore[union-attr]  # all are stored
