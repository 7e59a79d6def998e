"""Drape distances from drapes at hand and from a store."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from metric.backends import get_backend
from metric.drape_distance import drape_distance
from metric.stored import renders_from_drapes, renders_from_store
from renderer.store import RowStatus, ShardRows, Store, StoreLayout, StoreWriter
from simcore.drape import Drape, DrapeStatus
from simcore.errors import InputError
from simcore.mesh import GridMesh
from simcore.scenes import Scene

MESH = GridMesh(0.025)
LAYOUT = StoreLayout(
    materials=3,
    scenes=("hanging", "stretch"),
    jitters=2,
    inclinations_deg=(-5.0, 5.0),
    simulations_per_shard=12,
    vertex_count=MESH.vertex_count,
    picture_size=(32, 32),
)
FABRIC = np.array([1000.0, 800.0, 300.0, 5e-5, 4e-5, 4e-5, 0.2])


def vertices(folds: float, phase: float) -> np.ndarray:
    u, v = MESH.material_coordinates.T
    return np.stack([0.85 * (u - 0.25), -v, 0.03 * (1.1 + np.sin(folds * 2 * np.pi * u + phase))], axis=1)


def drape(folds: float, phase: float, status: DrapeStatus = DrapeStatus.STILL) -> Drape:
    return Drape(MESH, vertices(folds, phase), status, 1e-4, -0.1, True, 10, 0.1)


@pytest.fixture
def store(tmp_path: Path) -> Store:
    """Materials 0 and 1 of two repeats, the second repeat of material 1 diverged; none of material 2 came to rest."""
    address = np.array([LAYOUT.address(s) for s in range(LAYOUT.simulations)])
    rows = np.repeat(address, LAYOUT.pictures, axis=0)
    bad = (rows[:, 0] == 2) | ((rows[:, 0] == 1) & (rows[:, 2] == 1))
    count = len(rows)
    writer = StoreWriter.create(tmp_path / "s.zarr", LAYOUT, configuration={}, seed=0, software_version="0")
    writer.write_shard(
        0,
        ShardRows(
            depth=np.full((count, 32, 32), 9000, np.uint16),
            parameters=(FABRIC * (1 + 0.1 * rows[:, :1])).astype(np.float32),
            scene=rows[:, 1].astype(np.uint8),
            status=np.where(bad, RowStatus.DIVERGED, RowStatus.OK).astype(np.uint8),
            reason=np.where(bad, "forces grew", "").astype(object),
            inclination_deg=np.tile(LAYOUT.inclinations_deg, LAYOUT.simulations).astype(np.float32),
            seed=np.zeros(count, np.uint64),
            material=rows[:, 0].astype(np.uint32),
            jitter=rows[:, 2].astype(np.uint32),
            vertices=np.stack([vertices(1.5 + m, 0.2 * j + s) for m, s, j in address]).astype(np.float32),
            residual=np.zeros(LAYOUT.simulations),
            energy=np.zeros(LAYOUT.simulations),
        ),
    )
    return Store.open(tmp_path / "s.zarr")


def test_from_drapes() -> None:
    renders = renders_from_drapes([drape(2.0, 0.0), drape(2.0, 0.3)])
    assert len(renders) == 2
    assert renders[0].need_shaded().shape == renders[0].need_depth().shape == (256, 256)
    assert renders[0].height[renders[0].mask].max() == pytest.approx(0.063, abs=0.003)
    with pytest.raises(InputError, match=r"drape 1 is not at rest \(diverged.*leave it out") as caught:
        renders_from_drapes([drape(2.0, 0.0), drape(2.0, 0.0, DrapeStatus.DIVERGED)])
    assert caught.value.code == "drape_not_still"


def test_from_a_store(store: Store) -> None:
    found = renders_from_store(store, 0)
    assert {scene: len(renders) for scene, renders in found.scenes.items()} == {Scene.HANGING: 2, Scene.STRETCH: 2}
    assert found.failed == []
    assert found.fabric.density == pytest.approx(0.2)
    direct = renders_from_drapes([replace(drape(1.5, 0.0), vertices=vertices(1.5, 0.0).astype(np.float32))])[0]
    assert found.scenes[Scene.HANGING][0].shaded_key == direct.shaded_key

    other = renders_from_store(store, 1)
    assert {len(renders) for renders in other.scenes.values()} == {1}
    assert other.failed == ["hanging 1: diverged forces grew", "stretch 1: diverged forces grew"]
    distance = drape_distance(found.scenes, other.scenes, get_backend("depth"))
    assert distance.distance > 0
    assert distance.standard_error is None  # one repeat on one side


def test_parameters_are_those_of_a_usable_row(store: Store) -> None:
    status, parameters = store.status.copy(), store.parameters.copy()
    status[0], parameters[0] = RowStatus.MISSING, 0.0  # its shard is not finished
    stub = SimpleNamespace(
        layout=store.layout, status=status, ok=status == RowStatus.OK, reason=store.reason, parameters=parameters,
        vertices=store.vertices,
    )  # fmt: skip
    found = renders_from_store(stub, 0)  # type: ignore[arg-type]  # all that is read of it
    assert found.fabric == renders_from_store(store, 0).fabric
    assert len(found.scenes[Scene.HANGING]) == 1 and found.failed == ["hanging 0: missing"]


def test_what_the_store_does_not_hold(store: Store) -> None:
    for material in (3, -1):
        with pytest.raises(InputError, match="0 to 2") as caught:
            renders_from_store(store, material)
        assert caught.value.code == "material_unknown"
    with pytest.raises(InputError, match=r"no usable drape in hanging, stretch \(.*diverged forces grew") as caught:
        renders_from_store(store, 2)
    assert caught.value.code == "material_failed"


def test_a_store_whose_drapes_lie_on_no_square_grid(store: Store) -> None:
    layout = store.layout.model_copy(update={"vertex_count": MESH.vertex_count - 1})
    stub = SimpleNamespace(layout=layout)
    with pytest.raises(InputError, match=f"{MESH.vertex_count - 1} vertices are no square grid") as caught:
        renders_from_store(stub, 0)  # type: ignore[arg-type]  # all that is read of it
    assert caught.value.code == "store_mesh"
