"""Sweeps whose shards are solved at once."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from renderer.store import RowStatus, Store
from services.cli.main import run
from services.dataset.configuration import differences
from services.dataset.cost import estimate_cost
from services.dataset.fabrics import plan_sweep
from services.dataset.shard import ShardTask
from services.dataset.solver_kind import SolverKind
from services.dataset.sweep import prepare_store
from services.dataset.validation import validate_store
from services.dataset.worker import ShardWorker
from tests.services.dataset_helpers import assert_same_store, small_sweep, told, write_without_ray

SMALL = {"materials": 2, "simulations_per_shard": 3}


@pytest.fixture(scope="module")
def batched(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store of two shards, each solved at once on the CPU."""
    return write_without_ray(tmp_path_factory.mktemp("batched") / "s.zarr", *small_sweep(solver="batch", **SMALL))


def test_a_batched_store_is_as_good_as_another(batched: Path, tmp_path: Path) -> None:
    store = Store.open(batched)
    assert store.ok.all() and validate_store(store).valid
    single = Store.open(write_without_ray(tmp_path / "s.zarr", *small_sweep(**SMALL)))
    assert np.array_equal(store.parameters, single.parameters)
    assert np.array_equal(store.column("seed"), single.column("seed"))


def test_a_shard_done_again_has_the_same_bits(batched: Path, tmp_path: Path) -> None:
    assert_same_store(batched, write_without_ray(tmp_path / "s.zarr", *small_sweep(solver="batch", **SMALL)))


def test_one_by_one_they_are_solved_too(tmp_path: Path) -> None:
    configuration, fabrics = small_sweep(solver="batch", materials=1, simulations_per_shard=2)
    place = str(tmp_path / "s.zarr")
    prepare_store(place, configuration, resume=False)
    words = told(ShardWorker(place, configuration), ShardTask(0, fabrics.parameters([0, 0]), {}, one_by_one=True))
    assert [word.status for word in words] == [RowStatus.OK, RowStatus.OK]
    assert validate_store(Store.open(place)).valid


def test_a_simulation_given_up_is_not_solved_ahead(tmp_path: Path) -> None:
    configuration, fabrics = small_sweep(solver="batch", materials=1, simulations_per_shard=2)
    place = str(tmp_path / "s.zarr")
    prepare_store(place, configuration, resume=False)
    task = ShardTask(0, fabrics.parameters([0, 0]), {0: (RowStatus.CRASHED, "it killed three workers")})
    words = told(ShardWorker(place, configuration), task)
    assert [word.status for word in words] == [RowStatus.CRASHED, RowStatus.OK]


def test_the_solver_belongs_to_the_configuration() -> None:
    single, _ = plan_sweep(materials=3)
    batch, _ = plan_sweep(materials=3, solver="batch")
    assert differences(single.model_dump(mode="json"), batch) == ["solver"]
    # stores from before there was a choice
    assert differences(single.model_dump(mode="json", exclude={"solver"}), single) == []


def test_shards_for_a_gpu_are_larger() -> None:
    large = {"materials": 10_000, "jitters": 2}
    assert plan_sweep(**large)[0].simulations_per_shard == 32
    assert plan_sweep(**large, solver=SolverKind.CUDA)[0].simulations_per_shard == 256


def test_the_cost_of_a_solver_that_was_not_measured_says_so() -> None:
    assert estimate_cost(plan_sweep(materials=3)[0], 2).note == ""
    assert "not known" in estimate_cost(plan_sweep(materials=3, solver="cuda")[0], 2).note


@pytest.mark.ray
def test_no_gpu_is_one_clear_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import torch

    if torch.cuda.is_available():
        pytest.skip("this machine has a GPU")
    out = tmp_path / "s.zarr"
    assert run(["dataset", "--materials", "1", "--resolution", "0.05", "--solver", "cuda", "--out", str(out)]) == 2
    message = capsys.readouterr().err.strip()
    assert "no GPU here" in message and "\n" not in message
    assert not out.exists()
