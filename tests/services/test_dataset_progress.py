"""What is said of a sweep on its way: every simulation counts once, however often it is done. Ray is not started."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from renderer.store import RowStatus, Store, StoreWriter
from services.dataset import sweep
from services.dataset.cost import CostEstimate
from services.dataset.drive import Drive
from services.dataset.metrics import SweepMetrics
from services.dataset.worker import SimulationDone
from services.jobs.kinds import dataset
from services.jobs.task import Resources, Task
from simcore.errors import StoreError
from tests.services.dataset_helpers import small_sweep
from tests.services.dataset_rows import rows_of

TOLD = (0, 1, 3, 0, 1, 2, 3)
"""By workers, the first of which was lost behind its second simulation."""


def word(simulation: int) -> SimulationDone:
    """A worker's."""
    return SimulationDone(simulation, RowStatus.OK, 1, "here", 1, 1, False)


def without_ray(
    monkeypatch: pytest.MonkeyPatch, run: Callable[[Drive, Callable[[SimulationDone], None]], None]
) -> None:
    """A sweep is run by this and on one core."""

    @contextmanager
    def cluster(*given: object, **named: object) -> Iterator[int]:
        yield 1

    monkeypatch.setattr(sweep, "ray_cluster", cluster)
    monkeypatch.setattr(sweep, "is_ray_client", lambda: False)
    monkeypatch.setattr(Drive, "run", run)


def test_simulations_that_are_done_again_are_heard_of_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def run(drive: Drive, listen: Callable[[SimulationDone], None]) -> None:
        for simulation in TOLD:
            listen(word(simulation))
        writer = StoreWriter.open(drive.url)
        for shard in drive.shards:
            writer.write_shard(shard, rows_of(shard, drive.configuration, drive.fabrics))

    without_ray(monkeypatch, run)
    heard: list[int] = []
    sweep.run_sweep(tmp_path / "s.zarr", *small_sweep(materials=2), listen=lambda word: heard.append(word.simulation))
    assert heard == [0, 1, 3, 2]


def test_shards_that_are_gone_at_the_end_are_told_of_and_done_by_the_next_sweep(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another sweep took them away behind this one's back."""
    store, asked = tmp_path / "s.zarr", small_sweep(materials=2)

    def run(drive: Drive, listen: Callable[[SimulationDone], None]) -> None:
        writer = StoreWriter.open(drive.url)
        for shard in drive.shards[:1]:
            writer.write_shard(shard, rows_of(shard, drive.configuration, drive.fabrics))

    without_ray(monkeypatch, run)
    with pytest.raises(StoreError, match=f"^1 shards of {store} are not there, though each was stored") as caught:
        sweep.run_sweep(store, *asked)
    assert caught.value.code == "shards_missing"
    assert sweep.run_sweep(store, *asked, resume=True).samples == 8
    assert Store.open(store).complete.all()


def test_metrics_count_them_once(monkeypatch: pytest.MonkeyPatch) -> None:
    counted: list[str] = []

    def metric(name: str, *given: object, **named: object) -> SimpleNamespace:
        return SimpleNamespace(
            inc=lambda tags=None: counted.append(name), set=lambda *given, **named: None, observe=lambda value: None
        )

    for kind in ("Counter", "Gauge", "Histogram"):
        monkeypatch.setattr(f"ray.util.metrics.{kind}", metric)
    metrics = SweepMetrics()
    for simulation in TOLD:
        metrics.count(word(simulation))
    assert counted == ["drapemeter_simulations_total"] * 4
    metrics.count(replace(word(4), stored=True, found=True))  # another driver's work
    assert counted == ["drapemeter_simulations_total"] * 4
    metrics.count(replace(word(5), stored=True))
    assert counted[4:] == ["drapemeter_simulations_total", "drapemeter_shards_total"]


def test_a_job_that_goes_on_counts_what_is_done(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def run_sweep(
        *given: object,
        begin: Callable[[CostEstimate], None],
        listen: Callable[[SimulationDone], None],
        **named: object,
    ) -> sweep.SweepSummary:
        assert named["address"] == "local"  # whatever RAY_ADDRESS says
        begin(CostEstimate(3, 3, 0.1, 0.1, 0.1, 1))
        for simulation in (1, 2, 3):
            listen(word(simulation))
        return sweep.SweepSummary(4, {}, 1.0)

    monkeypatch.setattr(sweep, "run_sweep", run_sweep)
    said: list[tuple[float, str]] = []
    inputs = {"materials": 2, "jitters": 1, "inclinations": 1, "resolution_m": 0.05}
    task = Task("7", "dataset", inputs, (), Resources(dataset_root=str(tmp_path)), tmp_path)
    dataset.run(task, lambda fraction, message="": said.append((fraction, message)))
    assert said == [(share / 4, f"{share} of 4 simulations") for share in (2, 3, 4)]
