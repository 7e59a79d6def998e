"""What simulations are kept under: everything that changes them."""

from __future__ import annotations

import dataclasses
import importlib
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray

from diagnosis.scene import SimulationScene
from diagnosis.simulation import drape_cache
from diagnosis.simulation.drape_cache import DrapeCache, content_key, drape_key
from diagnosis.simulation.state_library import MOST_STATES, StateLibrary
from simcore.errors import InputError
from simcore.mechanics import CurvatureField, Mechanics, UniformCurvature
from simcore.mesh import GridMesh
from simcore.parameters import FabricParameters
from simcore.scenes import Setup

Array = NDArray[np.float64]
FABRIC = FabricParameters(800.0, 600.0, 150.0, 4e-5, 3e-5, 5e-5, 0.2)


@dataclass(frozen=True)
class Ripple:
    amplitude: float

    def evaluate(self, u: Array, v: Array, size_m: tuple[float, float]) -> tuple[Array, Array]:
        return self.amplitude * np.sin(20 * u), np.zeros(v.shape)


@dataclass(frozen=True)
class Dent:
    amplitude: float

    def evaluate(self, u: Array, v: Array, size_m: tuple[float, float]) -> tuple[Array, Array]:
        return np.zeros(u.shape), self.amplitude * np.exp(-100 * v**2)


class Plain:
    """No dataclass: nothing tells two of them apart."""

    def evaluate(self, u: Array, v: Array, size_m: tuple[float, float]) -> tuple[Array, Array]:
        return np.ones(u.shape), np.zeros(v.shape)


def key(field: CurvatureField) -> str:
    mesh = GridMesh(0.02)
    return drape_key(mesh, FABRIC, Setup.nominal("stretch"), Mechanics(rest_curvature=(field,)))


def test_a_users_own_fields_are_told_apart_by_what_they_are() -> None:
    keys = [key(field) for field in (Ripple(5.0), Ripple(6.0), Dent(5.0), UniformCurvature(5.0))]
    assert len(set(keys)) == 4
    assert key(Ripple(5.0)) == keys[0]


def test_a_users_class_is_told_apart_by_all_of_its_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What it does may lie in a constant beside it."""
    keys = []
    for size in (1, 2):
        name = f"own_shape_{size}"
        text = f"from dataclasses import dataclass\nSIZE = {size}\n@dataclass\nclass Shape:\n    a: int = 1\n"
        (tmp_path / f"{name}.py").write_text(text)
        monkeypatch.syspath_prepend(str(tmp_path))
        shape = importlib.import_module(name).Shape
        shape.__module__ = name
        keys.append(drape_cache._source(shape).split()[-1])
    assert keys[0] != keys[1]


def test_states_that_several_processes_add_are_all_kept(tmp_path: Path) -> None:
    mesh, fabric = GridMesh(0.05), FabricParameters(1000, 800, 300, 1.5e-5, 1.5e-5, 1.5e-5, 0.2)
    cache = DrapeCache(tmp_path)
    for number in range(20):
        cache.put_arrays(f"k{number}", {})
    library = StateLibrary.of(cache, mesh, fabric, SimulationScene(Setup.nominal("stretch")))
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda n: library.add(SimpleNamespace(key=f"k{n}")), range(20)))  # type: ignore[arg-type]
    assert set(library._keys()) == {f"k{n}" for n in range(20)}
    closed = replace(library, cache=DrapeCache(tmp_path, learns=False))
    closed.add(SimpleNamespace(key="of an opened label"))  # type: ignore[arg-type]
    assert set(closed._keys()) == {f"k{n}" for n in range(20)}


def test_states_whose_drapes_were_deleted_leave_room_for_others(tmp_path: Path) -> None:
    mesh, fabric = GridMesh(0.05), FabricParameters(1000, 800, 300, 1.5e-5, 1.5e-5, 1.5e-5, 0.2)
    cache = DrapeCache(tmp_path)
    library = StateLibrary.of(cache, mesh, fabric, SimulationScene(Setup.nominal("stretch")))
    for number in range(MOST_STATES + 1):
        cache.put_arrays(f"k{number}", {})
        library.add(SimpleNamespace(key=f"k{number}"))  # type: ignore[arg-type]
    assert len(library._keys()) == MOST_STATES  # full, while they are there
    for path in tmp_path.rglob("k*.npz"):
        path.unlink()
    cache.put_arrays("new", {})
    library.add(SimpleNamespace(key="new"))  # type: ignore[arg-type]
    assert library._keys() == ["new"]


def test_the_users_cache_keeps_what_was_used_last(tmp_path: Path) -> None:
    cache = DrapeCache(tmp_path, most_bytes=1500)
    for key in ("aa", "bb", "cc"):
        cache.put_arrays(key, {"x": np.random.default_rng(0).normal(size=100)})
        place = tmp_path / key / f"{key}.npz"
        os.utime(place, (1000, 1000 + ord(key[0])))
    assert 500 < place.stat().st_size < 750  # two of the three may stay
    assert cache.get_arrays("aa") is not None
    cache.trim()
    assert [cache.has(key) for key in ("aa", "bb", "cc")] == [True, False, True]
    atlas = DrapeCache(tmp_path)
    atlas.trim()  # has no limit
    assert atlas.has("cc")


def test_what_came_later_changes_no_key_until_it_is_used() -> None:
    """The key of drapes that were kept before there was a ``trim_kg_m`` (of solver version 6)."""
    mesh, scene = GridMesh(0.02), Setup.nominal("stretch")
    plain, hem, trim = (
        drape_key(mesh, FABRIC, scene, mechanics)
        for mechanics in (Mechanics(), Mechanics(hem_kg_m=0.02), Mechanics(trim_kg_m=(0.0, 0.0, 0.0, 0.02)))
    )
    fields = {f.name: getattr(Mechanics(), f.name) for f in dataclasses.fields(Mechanics) if f.name != "trim_kg_m"}
    assert content_key(mechanics=Mechanics()) == content_key(mechanics=fields)
    assert len({plain, hem, trim}) == 3


def test_what_nothing_tells_apart_is_refused() -> None:
    with pytest.raises(InputError, match="dataclass") as caught:
        key(Plain())
    assert caught.value.code == "effect_file"
    assert content_key(path=GridMesh(0.02)) == content_key(path=GridMesh(0.02))
