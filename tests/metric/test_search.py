"""Search by drape: exact and sketched rankings, caches, and the index's speed-independent facts."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest

from metric import search
from metric.backends import SquaredEuclideanBackend
from metric.descriptor import DescriptorStore, FabricDescriptor, thumbnail
from metric.draping import DrapeRequest, RequestResult
from metric.index import FabricIndex
from metric.library import LibraryFabric
from metric.render import DrapeRender
from metric.render_cache import RenderCache
from metric.search import RankedFabric, search_library
from metric.simulate import SimulationPlan
from metric.sketch import Sketched
from metric.uncertainty import mean_and_error
from simcore.errors import InputError, SimulationError
from simcore.parameters import FabricParameters
from simcore.scenes import Scene

MakeRender = Callable[..., DrapeRender]
PLAN = SimulationPlan(simulations=3, resolution_m=0.02)


def fabric(stiffness: float) -> FabricParameters:
    return FabricParameters(300.0, 250.0, 80.0, 1e-5 * stiffness, 1e-5 * stiffness, 1e-5 * stiffness, 0.2)


class FakeSimulations:
    """Folds by stiffness; stands for the solver and counts its runs."""

    def __init__(self, make: MakeRender) -> None:
        self.make = make
        self.runs = 0

    def __call__(self, requests: Sequence[DrapeRequest]) -> Iterator[RequestResult]:
        for request in requests:
            self.runs += 1
            folds = 6.0 / request.fabric.bending_warp**0.2 / 10 + (request.scene is Scene.STRETCH)
            yield RequestResult(request, self.make(folds, 0.1 * request.repeat))


def library(count: int) -> list[LibraryFabric]:
    return [LibraryFabric(f"s{k}", fabric(1.5**k)) for k in range(count)]


def order(found: list[RankedFabric]) -> list[str]:
    return [entry.id for entry in found]


def test_nearest_first(make_render: MakeRender, pixels: SquaredEuclideanBackend) -> None:
    found = search_library(fabric(1.5**2), library(6), pixels, PLAN, runner=FakeSimulations(make_render))
    assert order(found.ranking)[0] == "s2"
    assert [r.distance for r in found.ranking] == sorted(r.distance for r in found.ranking)
    assert all(r.standard_error is not None for r in found.ranking)
    assert found.ranking[0].distance > 0  # another sample of the same fabric, not the same pictures
    assert found.reference_pictures[Scene.HANGING].shape == (64, 64)


def test_sketches_give_the_same_ranking(make_render: MakeRender, pixels: SquaredEuclideanBackend) -> None:
    runner = FakeSimulations(make_render)
    exact = search_library(fabric(2.0), library(6), pixels, PLAN, runner=runner, exact=True).ranking
    sketched = search_library(fabric(2.0), library(6), pixels, PLAN, runner=runner, exact=False).ranking
    assert order(exact) == order(sketched)
    assert [r.distance for r in sketched] == pytest.approx([r.distance for r in exact], rel=0.06)
    assert [r.standard_error for r in sketched] == pytest.approx([r.standard_error for r in exact], rel=0.3)


def test_a_second_query_simulates_nothing(
    make_render: MakeRender, tmp_path: Path, pixels: SquaredEuclideanBackend
) -> None:
    runner, done = FakeSimulations(make_render), []
    for _ in range(2):
        search_library(
            fabric(2.0),
            library(5),
            pixels,
            PLAN,
            runner=runner,
            descriptors=DescriptorStore(tmp_path),
            exact=False,
            on_done=lambda: done.append(1),
        )
    assert runner.runs == 6 * 2 * 3
    assert len(done) == 2 * runner.runs


@pytest.mark.parametrize("exact", [True, False])
def test_fabrics_that_cannot_be_simulated_are_named(
    make_render: MakeRender, pixels: SquaredEuclideanBackend, exact: bool
) -> None:
    simulations = FakeSimulations(make_render)
    entries = library(4)
    bad = {entries[1].parameters}

    def runner(requests: Sequence[DrapeRequest]) -> Iterator[RequestResult]:
        for result in simulations(requests):
            lost = result.request.fabric in bad and result.request.repeat == 1
            yield RequestResult(result.request, None, ("not_still",)) if lost else result

    found = search_library(fabric(2.0), entries, pixels, PLAN, runner=runner, exact=exact)
    assert sorted(order(found.ranking)) == ["s0", "s2", "s3"]
    assert [f.id for f in found.failed] == ["s1"]
    assert "2 of 6 simulations did not come to rest" in found.failed[0].reason
    bad.update(entry.parameters for entry in entries)
    with pytest.raises(SimulationError, match=r"every fabric.*try another --seed") as caught:
        search_library(fabric(2.0), entries, pixels, PLAN, runner=runner, exact=exact)
    assert caught.value.code == "simulation_not_still"
    bad = {fabric(2.0)}
    with pytest.raises(SimulationError, match=r"the reference.*try another --seed") as caught:
        search_library(fabric(2.0), entries, pixels, PLAN, runner=runner, exact=exact)
    assert caught.value.code == "simulation_not_still"


@pytest.mark.parametrize("exact", [True, False])
def test_a_fabric_that_cannot_be_simulated_is_not_simulated_again(
    make_render: MakeRender, tmp_path: Path, pixels: SquaredEuclideanBackend, exact: bool
) -> None:
    simulations, entries = FakeSimulations(make_render), library(4)

    def runner(requests: Sequence[DrapeRequest]) -> Iterator[RequestResult]:
        for result in simulations(requests):
            lost = result.request.fabric == entries[1].parameters
            yield RequestResult(result.request, None, ("not_still",) * 3) if lost else result

    kept = {"renders": RenderCache(tmp_path / "renders"), "descriptors": DescriptorStore(tmp_path / "descriptors")}
    found = [search_library(fabric(2.0), entries, pixels, PLAN, runner=runner, exact=exact, **kept) for _ in range(2)]
    assert simulations.runs == 5 * 2 * 3
    assert found[0].failed == found[1].failed and [lost.id for lost in found[1].failed] == ["s1"]
    assert order(found[0].ranking) == order(found[1].ranking)


def test_descriptors_survive_on_disk_and_damage_is_a_miss(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    kept = FabricDescriptor(
        {s: rng.normal(0, 1, (3, 32)).astype(np.float32) for s in Scene},
        {s: rng.integers(0, 255, (8, 8)).astype(np.uint8) for s in Scene},
    )
    DescriptorStore(tmp_path).save("k", kept)
    found = DescriptorStore(tmp_path).load("k")
    assert found is not None
    for scene in Scene:
        assert np.array_equal(found.sketches[scene], kept.sketches[scene])
        assert np.array_equal(found.pictures[scene], kept.pictures[scene])
    (tmp_path / "k.npz").write_bytes((tmp_path / "k.npz").read_bytes()[:100])
    assert DescriptorStore(tmp_path).load("k") is None
    assert DescriptorStore().load("k") is None


def test_index_equals_the_definition(pixels: SquaredEuclideanBackend) -> None:
    rng = np.random.default_rng(1)
    descriptors = [
        FabricDescriptor({s: rng.normal(k, 1, (4, 64)).astype(np.float32) for s in Scene}, {}) for k in range(5)
    ]
    index = FabricIndex(Sketched(pixels, 64), descriptors[1:])
    assert len(index) == 4
    found = index.query(descriptors[0])
    assert [r.place for r in found] == [0, 1, 2, 3]
    for entry in found:
        pairs = [
            mean_and_error(
                np.sum(
                    (descriptors[0].sketches[s][:, None] - descriptors[1 + entry.place].sketches[s][None]) ** 2, axis=2
                ).astype(float)
            )
            for s in Scene
        ]
        assert entry.distance == pytest.approx(np.mean([m for m, _ in pairs]), rel=1e-5)
        assert entry.standard_error == pytest.approx(np.hypot(*[e or 0.0 for _, e in pairs]) / 2, rel=1e-4)


def test_uneven_descriptors_are_refused(pixels: SquaredEuclideanBackend) -> None:
    one = FabricDescriptor({Scene.HANGING: np.zeros((2, 8), np.float32)}, {})
    other = FabricDescriptor({Scene.HANGING: np.zeros((3, 8), np.float32)}, {})
    backend = Sketched(pixels, 8)
    for descriptors in ([one, other], []):
        with pytest.raises(InputError, match="at least one fabric, and equally many renders") as caught:
            FabricIndex(backend, descriptors)
        assert caught.value.code == "index_uneven"
    with pytest.raises(InputError, match="other scenes") as caught:
        FabricIndex(backend, [one]).query(FabricDescriptor({Scene.STRETCH: np.zeros((2, 8), np.float32)}, {}))
    assert caught.value.code == "scenes_differ"


def test_thumbnails_are_half_size(make_render: MakeRender) -> None:
    render = make_render(size=128)
    small = thumbnail(render)
    assert small.shape == (64, 64)
    assert small.mean() == pytest.approx(render.need_shaded().mean(), abs=1.0)


def test_a_folder_spares_memory_and_damage_counts_as_absent(tmp_path: Path) -> None:
    picture = np.arange(64.0).reshape(8, 8)
    described = FabricDescriptor({Scene.HANGING: picture}, {Scene.HANGING: picture})
    store = DescriptorStore(tmp_path, most=2)
    for key in "abc":
        store.save(key, described)
    assert len(store._memory) == 2 and store.load("a") is not None and len(store._memory) == 2
    (kept,) = tmp_path.glob("b.npz")
    content = kept.read_bytes()
    middle = len(content) // 2
    for damaged in (content[:middle], content[:middle] + bytes(50) + content[middle + 50 :]):
        kept.write_bytes(damaged)
        assert DescriptorStore(tmp_path).load("b") is None
    kept.unlink()
    kept.mkdir()  # as a file that this user may not read
    assert DescriptorStore(tmp_path).load("b") is None
    alone = DescriptorStore(most=2)
    for key in "abc":
        alone.save(key, described)
    assert alone.load("a") is not None, "what is kept nowhere else stays"


@pytest.mark.parametrize("on_disk", [False, True])
def test_memory_holds_no_more_bytes_than_it_may(on_disk: bool, tmp_path: Path) -> None:
    """One that is kept anew counts once, and one that is larger than all that may be is held alone."""
    row = np.zeros((1, 100), np.float32)
    described = FabricDescriptor({Scene.HANGING: row}, {Scene.HANGING: np.zeros((10, 10), np.uint8)})
    assert described.nbytes == 500
    store = DescriptorStore(tmp_path if on_disk else None, memory_bytes=1200)
    for key in "aabab":
        store.save(key, described)
    assert set(store._memory) == {"a", "b"}
    assert store.load("a") is not None
    store.save("c", described)
    assert set(store._memory) == {"a", "c"} and (store.load("b") is not None) is on_disk
    store.save("d", FabricDescriptor({Scene.HANGING: np.zeros((1, 1000), np.float32)}, {}))
    assert set(store._memory) == {"d"}
    store.save("a", described)
    assert set(store._memory) == {"a"}


def test_a_search_needs_nothing_that_memory_let_go(make_render: MakeRender, pixels: SquaredEuclideanBackend) -> None:
    whole = search_library(fabric(2.0), library(5), pixels, PLAN, runner=FakeSimulations(make_render), exact=False)
    little = DescriptorStore(memory_bytes=1)
    found = search_library(
        fabric(2.0), library(5), pixels, PLAN, runner=FakeSimulations(make_render), descriptors=little, exact=False
    )
    assert found.ranking == whole.ranking and len(little._memory) == 1


def test_renders_of_a_large_library_are_not_held_at_once(
    make_render: MakeRender, pixels: SquaredEuclideanBackend, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Exact search as well, which back ends without sketches always do."""
    plain = search_library(fabric(3.0), library(7), pixels, PLAN, runner=FakeSimulations(make_render), exact=True)
    monkeypatch.setattr(search, "_FABRICS_AT_A_TIME", 2)
    most = []

    class Counted(FakeSimulations):
        def __call__(self, requests: Sequence[DrapeRequest]) -> Iterator[RequestResult]:
            most.append(len({request.fabric for request in requests}))
            return super().__call__(requests)

    found = search_library(fabric(3.0), library(7), pixels, PLAN, runner=Counted(make_render), exact=True)
    assert most == [1, 2, 2, 2, 1]
    assert [(r.id, r.distance) for r in found.ranking] == [(r.id, r.distance) for r in plain.ranking]
