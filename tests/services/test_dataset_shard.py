"""One shard's work: every failure is a row with a status and a reason, and rows can be made again."""

from __future__ import annotations

import shutil
import socket
from pathlib import Path

import numpy as np
import pytest

from diagnosis.extension import AppliedEffect
from renderer.store import RowStatus, Store, StoreWriter
from services.dataset.inspection import inspect_store
from services.dataset.shard import (
    ShardTask,
    as_fabric,
    picture_fault,
    shard_requests,
    simulate_and_render,
    simulate_shard,
)
from services.dataset.sweep import prepare_store
from services.dataset.worker import ShardWorker
from simcore.drape import Drape, DrapeStatus
from simcore.errors import InputError, MissingResourceError, OutOfMemoryError, SimulationError
from simcore.parameters import LIMITS, PARAMETER_NAMES, FabricParameters
from simcore.scenes import Setup
from simcore.solver import Solver
from tests.services.dataset_helpers import small_sweep, told, write_without_ray
from tests.services.dataset_rows import made_up_store

CONFIGURATION, FABRICS = small_sweep()
FABRIC = FABRICS.parameters([0])[0]


class StubSolver(Solver):
    """Returns or raises what it is told, in place of a simulation."""

    def __init__(self, result: Drape | Exception) -> None:
        self.result = result

    def solve(self, *arguments: object, **options: object) -> Drape:  # type: ignore[override]  # any call will do
        """The prepared result."""
        if isinstance(self.result, Exception):
            raise self.result
        return self.result


def drape(status: DrapeStatus = DrapeStatus.STILL, reason: str = "", seconds: float = 0.1, z: float = 0.05) -> Drape:
    """A bulging sheet with a chosen ending."""
    u, v = CONFIGURATION.mesh.material_coordinates.T
    vertices = np.stack([u - 0.25, -v, 0.001 + z * np.sin(np.pi * u / 0.5)], axis=1)
    return Drape(CONFIGURATION.mesh, vertices, status, 1e-4, -0.1, True, 7, seconds, reason)


@pytest.mark.parametrize(
    ("result", "status", "reason"),
    [
        (drape(), RowStatus.OK, ""),
        (drape(DrapeStatus.NOT_STILL, "residual 2"), RowStatus.NOT_STILL, "residual 2"),
        (drape(DrapeStatus.NOT_STILL, "time limit", seconds=121.0), RowStatus.TIMED_OUT, "time limit"),
        (drape(DrapeStatus.UNDER_RESOLVED, "zigzag"), RowStatus.UNDER_RESOLVED, "zigzag"),
        (drape(DrapeStatus.UNDER_RESOLVED, "zigzag", seconds=121.0), RowStatus.UNDER_RESOLVED, "zigzag"),
        (drape(DrapeStatus.DIVERGED), RowStatus.DIVERGED, "diverged"),
        (drape(z=float("nan")), RowStatus.BAD_RENDER, "finite"),
        (SimulationError("no start"), RowStatus.REFUSED, "SimulationError: no start"),
        (ZeroDivisionError("x / 0"), RowStatus.CRASHED, "ZeroDivisionError: x / 0"),
        (np.linalg.LinAlgError("singular"), RowStatus.CRASHED, "LinAlgError: singular"),
        (IndexError("beyond"), RowStatus.CRASHED, "IndexError: beyond"),
    ],
)
def test_every_ending_has_its_status_and_reason(result: Drape | Exception, status: RowStatus, reason: str) -> None:
    outcome = simulate_and_render(FABRIC, "hanging", 1, CONFIGURATION, StubSolver(result))
    assert outcome.status is status
    assert reason in outcome.reason and bool(outcome.reason) == (status is not RowStatus.OK)
    assert outcome.depth.any() == (status is RowStatus.OK)


@pytest.mark.parametrize("lack", [OutOfMemoryError("out of memory: 2601 equations"), MemoryError("2 GiB")])
def test_a_lack_of_memory_leaves_the_shard_undone(lack: Exception, tmp_path: Path) -> None:
    """It passes, and says nothing of the simulation."""
    prepare_store(str(tmp_path / "s.zarr"), CONFIGURATION, resume=False)
    worker = ShardWorker(str(tmp_path / "s.zarr"), CONFIGURATION)
    worker._writer, worker._solver = StoreWriter.open(tmp_path / "s.zarr"), StubSolver(lack)
    with pytest.raises(OutOfMemoryError, match=r"out of memory.*(2601|2 GiB)"):
        list(worker.run(ShardTask(0, FABRICS.parameters([0, 0, 1]), {})))
    assert not Store.open(tmp_path / "s.zarr").complete.any()


def test_a_shard_that_is_stored_is_passed_over(tmp_path: Path) -> None:
    """By another driver of the store, or by one whose machine was lost; what it says of them is as stored."""
    configuration, fabrics = small_sweep(materials=2)
    store = made_up_store(tmp_path / "s.zarr", configuration, fabrics)
    before = Store.open(store).checksums
    worker = ShardWorker(str(store), configuration)
    worker._writer, worker._solver = StoreWriter.open(store), StubSolver(AssertionError("simulated"))
    words = told(worker, ShardTask(1, fabrics.parameters([1]), {}))
    assert [(w.simulation, w.status, w.stored, w.found) for w in words] == [(3, RowStatus.TIMED_OUT, True, True)]
    assert np.array_equal(Store.open(store).checksums, before)


@pytest.mark.parametrize(
    ("fault", "code", "said"),
    [
        (OSError(28, "No space left on device"), "no_room", "make room"),
        (OSError(24, "Too many open files"), "worker_machine", "Too many open files"),
        (ImportError("no such library"), "worker_machine", "no such library"),
        (MissingResourceError("no oneMKL"), "worker_machine", "no oneMKL"),
    ],
)
def test_what_the_machine_lacks_is_no_row(fault: Exception, code: str, said: str, tmp_path: Path) -> None:
    """Every simulation would be one. The machine is named."""
    prepare_store(str(tmp_path / "s.zarr"), CONFIGURATION, resume=False)
    worker = ShardWorker(str(tmp_path / "s.zarr"), CONFIGURATION)
    worker._writer, worker._solver = StoreWriter.open(tmp_path / "s.zarr"), StubSolver(fault)
    with pytest.raises(MissingResourceError) as caught:
        list(worker.run(ShardTask(0, FABRICS.parameters([0, 0, 1]), {})))
    assert caught.value.code == code
    assert said in str(caught.value) and socket.gethostname() in str(caught.value)
    assert not Store.open(tmp_path / "s.zarr").complete.any()


@pytest.mark.parametrize("fault", [TypeError("got an unexpected keyword"), AttributeError("no such field")])
def test_a_fault_of_the_program_is_no_row(fault: Exception) -> None:
    """A library of another version on a node, say: it ends the sweep, and a --resume does the rest."""
    with pytest.raises(type(fault)):
        simulate_and_render(FABRIC, "hanging", 1, CONFIGURATION, StubSolver(fault))


def test_values_at_the_limits_are_within_them_in_single_precision() -> None:
    for side in (0, 1):
        values = [LIMITS[name][side] for name in PARAMETER_NAMES]
        assert as_fabric(np.array(values, dtype=np.float32)).as_array().tolist() == values
    with pytest.raises(InputError):
        as_fabric(np.array([1, 1, 1, 1e-9, 1e-5, 1e-5, 0.2], dtype=np.float32))


def test_bad_pictures_are_noticed() -> None:
    good = np.linspace(0.8, 0.9, 2 * 16, dtype=np.float32).reshape(2, 4, 4)
    assert picture_fault(good) == ""
    assert picture_fault(np.concatenate([good, np.full((1, 4, 4), 0.9, np.float32)])) == "the picture is constant"
    assert picture_fault(np.zeros((1, 4, 4), np.float32)) == "nothing is seen"
    assert picture_fault(np.full((1, 4, 4), np.nan, np.float32)) == "depth is not finite"


def test_rows_tell_where_they_belong_and_failures_keep_their_place() -> None:
    task = ShardTask(6, FABRICS.parameters([9, 9]), {19: (RowStatus.CRASHED, "killed its worker, 3 times")})
    rows = [rows for _, rows in simulate_shard(task, CONFIGURATION, StubSolver(drape()))]
    assert [r.status.tolist() for r in rows] == [[RowStatus.OK] * 2, [RowStatus.CRASHED] * 2]
    assert rows[1].material.tolist() == [9, 9] and rows[1].scene.tolist() == [1, 1]
    assert rows[1].reason.tolist() == ["killed its worker, 3 times"] * 2
    assert np.isnan(rows[1].vertices).all() and not rows[1].depth.any()
    assert rows[0].inclination_deg.tolist() == [-5.0, 5.0]
    assert np.array_equal(rows[0].parameters, np.repeat(FABRICS.parameters([9]), 2, axis=0))


def test_a_shard_alone_and_again_gives_the_same_bits_and_simulate_makes_its_drape(tmp_path: Path) -> None:
    """A worker's past leaves no trace: the order of shards does not matter."""
    configuration, fabrics = small_sweep(materials=2)
    write_without_ray(tmp_path / "a.zarr", configuration, fabrics)
    write_without_ray(tmp_path / "b.zarr", configuration, fabrics)
    store = Store.open(tmp_path / "a.zarr")
    before = Store.open(tmp_path / "b.zarr").checksums
    shutil.rmtree(tmp_path / "b.zarr" / "checksum" / "c")  # the marks
    worker = ShardWorker(str(tmp_path / "b.zarr"), configuration)
    list(worker.run(ShardTask(1, fabrics.parameters([1]), {})))
    list(worker.run(ShardTask(0, fabrics.parameters([0, 0, 1]), {})))
    assert np.array_equal(before, store.checksums)
    assert np.array_equal(Store.open(tmp_path / "b.zarr").checksums, store.checksums)
    row = 2 * 2  # third simulation: material 1, hanging
    fabric = FabricParameters.from_array(store.parameters[row])
    again = Solver(configuration.mesh).solve(fabric, Setup.nominal("hanging"), seed=int(store.column("seed")[row]))
    assert np.array_equal(again.vertices.astype(np.float32), store.vertices(2))


def test_a_worker_does_not_grow_and_its_pictures_are_small(tmp_path: Path) -> None:
    """Solver's fields made anew for each task would take 0.6 MB a task."""
    configuration, fabrics = small_sweep(materials=20, simulations_per_shard=1)
    store = str(tmp_path / "s.zarr")
    worker = ShardWorker(store, configuration)
    shards = prepare_store(store, configuration, resume=False)
    words = [word for n in shards for word in told(worker, ShardTask(n, fabrics.parameters([n // 2]), {}))]
    assert len(words) == 40
    assert max(word.rss_bytes for word in words[30:]) - words[10].rss_bytes < 8e6
    assert inspect_store(Store.open(store)).float32_ratio > 5


@pytest.mark.parametrize(("effect", "magnitude"), [("dropout", 1.0), ("depth_bias", 8.0)])
def test_a_picture_that_the_sensor_spoils_is_a_row(effect: str, magnitude: float) -> None:
    spoilt = CONFIGURATION.model_copy(
        update={"simulator": (AppliedEffect(name=effect, size={"magnitude": magnitude}),)}
    )
    outcome = simulate_and_render(FABRIC, "hanging", 1, spoilt, StubSolver(drape()))
    assert outcome.status is RowStatus.BAD_RENDER and outcome.reason and not outcome.depth.any()


def test_what_a_batch_would_refuse_is_not_asked_of_it() -> None:
    apart = CONFIGURATION.model_copy(
        update={"simulator": (AppliedEffect(name="pin_spacing", size={"magnitude": 1.0}),)}
    )
    task = ShardTask(0, FABRICS.parameters(range(CONFIGURATION.simulations_per_shard)), {})
    assert shard_requests(task, apart) == {} and shard_requests(task, CONFIGURATION)
