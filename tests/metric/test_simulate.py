"""Simulated renders: real drapes on a coarse mesh, seeds, retries, failures, the cache on disk."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from metric import draping
from metric.backends import get_backend
from metric.compare import compare_fabrics
from metric.draping import DrapeRequest, RequestResult, run_request
from metric.render_cache import RenderCache
from metric.simulate import SimulationPlan, local_runner, simulate_fabrics
from renderer.user_cache import default_cache_folder
from simcore.drape import OUT_OF_TIME, Drape, DrapeStatus
from simcore.errors import InputError, MissingResourceError, SimulationError
from simcore.mesh import GridMesh
from simcore.parameters import FabricParameters
from simcore.scenes import Scene

MEDIUM = FabricParameters(1000.0, 800.0, 300.0, 5e-5, 4e-5, 4e-5, 0.2)
STIFF = FabricParameters(1000.0, 800.0, 300.0, 5e-4, 4e-4, 4e-4, 0.2)
PLAN = SimulationPlan(simulations=2, resolution_m=0.025, workers=1)


@pytest.fixture(scope="module")
def renders_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("renders")


def test_two_fabrics_from_their_parameters(renders_folder: Path) -> None:
    cache = RenderCache(renders_folder)
    done: list[int] = []
    found = compare_fabrics(
        MEDIUM, STIFF, get_backend("depth"), PLAN, renders=cache, on_done=lambda: done.append(1)
    ).result
    assert len(done) == 8
    assert set(found.scenes) == set(Scene)
    assert found.distance > 0
    assert found.standard_error is not None
    assert found.unit == "m"
    again = compare_fabrics(MEDIUM, STIFF, get_backend("depth"), PLAN, renders=cache).result
    assert again.distance == found.distance


def test_equal_fabrics_are_two_samples_of_one(renders_folder: Path) -> None:
    plan = SimulationPlan(simulations=1, resolution_m=0.025, workers=1)
    found = compare_fabrics(MEDIUM, MEDIUM, get_backend("depth"), plan, renders=RenderCache(renders_folder)).result
    assert found.distance > 0
    assert found.standard_error is None


def test_same_seed_same_pictures() -> None:
    first, second = (run_request(DrapeRequest(MEDIUM, Scene.HANGING, 0, 7, 0.025)).render for _ in range(2))
    assert first is not None
    assert second is not None
    assert np.array_equal(first.need_shaded(), second.need_shaded())
    assert np.array_equal(first.need_depth(), second.need_depth())
    other = run_request(DrapeRequest(MEDIUM, Scene.HANGING, 1, 7, 0.025)).render
    assert other is not None
    assert not np.array_equal(first.need_depth(), other.need_depth())
    # both pictures show the cloth in the same place
    assert np.mean((first.need_shaded() > 0) != first.mask) < 0.02


@pytest.mark.slow
def test_worker_processes_give_the_same_pictures(renders_folder: Path) -> None:
    requests = [DrapeRequest(MEDIUM, Scene.HANGING, k, 7, 0.025) for k in range(2)]
    spawned = {r.request: r.render for r in local_runner(2)(requests)}
    for request in requests:
        here, there = run_request(request).render, spawned[request]
        assert here is not None
        assert there is not None
        assert here.depth_key == there.depth_key


def test_seeds_of_different_fabrics_scenes_repeats_and_attempts_differ() -> None:
    base = DrapeRequest(MEDIUM, Scene.HANGING, 0, 0, 0.01)
    seeds = {
        base.solver_seed(0),
        base.solver_seed(1),
        DrapeRequest(STIFF, Scene.HANGING, 0, 0, 0.01).solver_seed(0),
        DrapeRequest(MEDIUM, Scene.STRETCH, 0, 0, 0.01).solver_seed(0),
        DrapeRequest(MEDIUM, Scene.HANGING, 1, 0, 0.01).solver_seed(0),
        DrapeRequest(MEDIUM, Scene.HANGING, 0, 1, 0.01).solver_seed(0),
    }
    assert len(seeds) == 6


class FailingSolver:
    """Comes to rest at the third attempt only."""

    def __init__(self, mesh: GridMesh, still_at: int) -> None:
        self.mesh = mesh
        self.still_at = still_at

    def solve(self, _fabric: object, _setup: object, *, seed: tuple[int, ...]) -> Drape:
        u, v = self.mesh.material_coordinates.T
        vertices = np.stack([u - 0.25, -v, 0.01 + 0.005 * np.sin(20 * u)], axis=1)
        still = seed[-1] >= self.still_at
        status = DrapeStatus.STILL if still else DrapeStatus.NOT_STILL
        return Drape(self.mesh, vertices, status, 0.5, -0.1, still, 10, 0.1, "" if still else "time limit")


@pytest.mark.parametrize("still_at", [2, 99])
def test_what_does_not_come_to_rest_is_tried_again_and_reported(still_at: int, monkeypatch: pytest.MonkeyPatch) -> None:
    solver = FailingSolver(GridMesh(0.025), still_at)
    monkeypatch.setattr(draping, "_solver", lambda _: solver)
    if still_at == 99:
        with pytest.raises(SimulationError, match=r"4 of 4 simulations.*time limit.*--seed") as caught:
            simulate_fabrics([MEDIUM], PLAN)
        assert caught.value.code == "simulation_not_still"
        (kept,) = simulate_fabrics([MEDIUM], PLAN, keep_failures=True)
        assert "time limit" in kept.failure
        return
    _, found = simulate_fabrics([STIFF, MEDIUM], PLAN)
    assert len(found.retries) == 4 and {r.fabric for r in found.retries} == {1}
    assert all(len(r.reasons) == 2 and "time limit" in r.reasons[0] for r in found.retries)
    assert all(len(renders) == 2 for renders in found.scenes.values())


def test_the_cache_keeps_apart_what_differs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(draping, "_solver", lambda _: FailingSolver(GridMesh(0.025), 1))
    cache, request = RenderCache(tmp_path), DrapeRequest(MEDIUM, Scene.HANGING, 0, 0, 0.025)
    assert cache.load(request) is None
    result = run_request(request)
    cache.save(result)
    found = cache.load(request)
    assert found is not None
    assert found.render is not None
    assert result.render is not None
    assert found.render.shaded_key == result.render.shaded_key
    assert found.failures == result.failures
    for other in (
        DrapeRequest(STIFF, Scene.HANGING, 0, 0, 0.025),
        DrapeRequest(MEDIUM, Scene.STRETCH, 0, 0, 0.025),
        DrapeRequest(MEDIUM, Scene.HANGING, 1, 0, 0.025),
        DrapeRequest(MEDIUM, Scene.HANGING, 0, 1, 0.025),
        DrapeRequest(MEDIUM, Scene.HANGING, 0, 0, 0.05),
    ):
        assert cache.load(other) is None
    # its first attempt did not come to rest
    assert cache.load(replace(request, attempts=1)) is None
    assert cache.load(replace(request, attempts=2)) is not None
    replace(cache, most_bytes=10**9).trim()
    assert cache.load(request) is not None
    for path in tmp_path.glob("*.npz"):
        path.write_bytes(path.read_bytes()[:200])
        assert cache.load(request) is None
        path.unlink()
        path.mkdir()  # as a file that this user may not read
    assert cache.load(request) is None


class NeverStill(FailingSolver):
    """Comes to rest in no attempt, for one reason; counts them."""

    def __init__(self, reason: str) -> None:
        super().__init__(GridMesh(0.025), 99)
        self.reason = reason
        self.attempts: list[int] = []

    def solve(self, fabric: object, setup: object, *, seed: tuple[int, ...]) -> Drape:
        self.attempts.append(seed[-1])
        return replace(super().solve(fabric, setup, seed=seed), reason=self.reason)


ONE = SimulationPlan(simulations=1, resolution_m=0.025, workers=1, scenes=(Scene.HANGING,))


def test_what_does_not_come_to_rest_is_kept_and_gone_on_from(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cache, solver = RenderCache(tmp_path), NeverStill("at a saddle that was not left")
    monkeypatch.setattr(draping, "_solver", lambda _: solver)
    done: list[int] = []
    told = [
        simulate_fabrics([MEDIUM], ONE, cache=cache, keep_failures=True, on_done=lambda: done.append(1))[0].failure
        for _ in range(2)
    ]
    assert solver.attempts == [0, 1, 2] and len(done) == 2
    assert told[0] == told[1] and "saddle" in told[0]
    (fewer,) = simulate_fabrics([MEDIUM], replace(ONE, attempts=2), cache=cache, keep_failures=True)
    assert fewer.failure and solver.attempts == [0, 1, 2]
    solver.still_at = 4
    (found,) = simulate_fabrics([MEDIUM], replace(ONE, attempts=5), cache=cache)
    assert solver.attempts == [0, 1, 2, 3, 4] and not found.failure
    assert len(found.retries[0].reasons) == 4
    (again,) = simulate_fabrics([MEDIUM], replace(ONE, attempts=5), cache=cache)
    assert again.retries == found.retries and len(solver.attempts) == 5
    (fewer,) = simulate_fabrics([MEDIUM], replace(ONE, attempts=4), cache=cache, keep_failures=True)
    assert fewer.failure and len(solver.attempts) == 5


def test_what_ran_out_of_time_is_tried_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    solver = NeverStill(f"{OUT_OF_TIME}; residual 0.5 vertex weights after 10 steps")
    monkeypatch.setattr(draping, "_solver", lambda _: solver)
    for _ in range(2):
        (found,) = simulate_fabrics([MEDIUM], ONE, cache=RenderCache(tmp_path), keep_failures=True)
        assert OUT_OF_TIME in found.failure
    assert solver.attempts == [0, 1, 2] * 2 and not list(tmp_path.glob("*.npz"))


def test_the_cache_stays_below_its_size(tmp_path: Path) -> None:
    render = run_request(DrapeRequest(MEDIUM, Scene.HANGING, 0, 7, 0.025)).render

    def runner(requests: Sequence[DrapeRequest]) -> Iterator[RequestResult]:
        yield from (RequestResult(r, render) for r in requests)

    simulate_fabrics([MEDIUM], PLAN, runner=runner, cache=RenderCache(tmp_path))
    sizes = [path.stat().st_size for path in tmp_path.glob("*.npz")]
    assert len(sizes) == 4
    simulate_fabrics([STIFF], PLAN, runner=runner, cache=RenderCache(tmp_path, most_bytes=5 * max(sizes)))
    assert len(list(tmp_path.glob("*.npz"))) == 5


def test_a_runner_gets_each_simulation_once() -> None:
    asked: list[DrapeRequest] = []
    render = run_request(DrapeRequest(MEDIUM, Scene.HANGING, 0, 7, 0.025)).render

    def runner(requests: Sequence[DrapeRequest]) -> Iterator[RequestResult]:
        asked.extend(requests)
        yield from (RequestResult(r, render) for r in reversed(requests))

    found = simulate_fabrics([MEDIUM, STIFF, MEDIUM], PLAN, runner=runner)
    assert len(asked) == len(set(asked)) == 8
    assert [f.fabric for f in found] == [MEDIUM, STIFF, MEDIUM]


@pytest.mark.parametrize(
    ("changes", "code", "told"),
    [
        ({"simulations": 0}, "simulations_out_of_range", "got 0: the paper takes 5"),
        ({"simulations": 10**6}, "simulations_out_of_range", "got 1000000"),
        ({"seed": -1}, "seed_out_of_range", "not be negative, got -1"),
        ({"workers": -1}, "plan_bad", "workers must be >= 0"),
        ({"attempts": 0}, "plan_bad", "attempts >= 1"),
        ({"scenes": ()}, "plan_bad", "at least one scene"),
    ],
)
def test_unusable_plans(changes: dict[str, Any], code: str, told: str) -> None:
    with pytest.raises(InputError, match=told) as caught:
        SimulationPlan(**changes)
    assert caught.value.code == code


def test_cache_folder_is_the_users_choice(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("DRAPEMETER_CACHE", str(tmp_path))
    assert default_cache_folder() == tmp_path
    monkeypatch.setenv("DRAPEMETER_CACHE", "")
    assert default_cache_folder() is None  # nothing is kept
    monkeypatch.delenv("DRAPEMETER_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert default_cache_folder() == tmp_path / "drapemeter"


def test_drapes_of_workers_of_another_version_are_neither_taken_nor_kept(tmp_path: Path) -> None:
    """As of a cluster's node that was not brought up to date."""

    def elsewhere(requests: Sequence[DrapeRequest]) -> Iterator[RequestResult]:
        for request in requests:
            yield replace(run_request(request), engine="0" * 64)

    plan = SimulationPlan(simulations=1, resolution_m=0.05, workers=1)
    with pytest.raises(MissingResourceError, match="another version of the program") as caught:
        simulate_fabrics([STIFF], plan, runner=elsewhere, cache=RenderCache(tmp_path / "renders"))
    assert caught.value.code == "workers_version" and not (tmp_path / "renders").exists()
