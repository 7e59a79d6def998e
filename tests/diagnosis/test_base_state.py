"""Where every fold state of a fabric has diverged there is none to hold against its capture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from diagnosis.scene import SimulationScene
from diagnosis.simulation import base_state
from diagnosis.simulation.base_state import nearest_state
from diagnosis.simulation.drape_cache import DrapeCache
from diagnosis.simulation.simulator import KeyedDrape, Simulator
from simcore.drape import Drape, DrapeStatus
from simcore.errors import SimulationError
from simcore.mesh import GridMesh
from simcore.parameters import FabricParameters
from simcore.scenes import Setup

FABRIC = FabricParameters(1000.0, 800.0, 300.0, 2e-5, 2e-5, 2e-5, 0.2)


def test_a_fabric_none_of_whose_drapes_is_finite_is_told_with_the_reason(tmp_path: Path) -> None:
    mesh = GridMesh(0.1)
    lost = np.full((mesh.vertex_count, 3), np.nan)
    drape = Drape(mesh, lost, DrapeStatus.DIVERGED, 1.0, 0.0, False, 3, 0.1, "forces grew without bound")
    simulator, scene = Simulator(DrapeCache(tmp_path)), SimulationScene(Setup.nominal("hanging"))
    picture = np.full((256, 256), 0.9, np.float32)
    candidates = [KeyedDrape(drape, name) for name in ("one", "other")]
    with pytest.raises(SimulationError, match="no drape of this fabric can be simulated: forces grew") as caught:
        nearest_state(simulator, FABRIC, scene, picture, candidates)
    assert caught.value.code == "diverged"
    assert simulator.cost.simulations == 0 and not list(tmp_path.rglob("*.npz"))


@pytest.mark.parametrize("led_ends_there", [False, True])
def test_folds_at_rest_are_not_hidden_by_the_same_that_are_not(
    led_ends_there: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mesh = GridMesh(0.1)
    flat = np.zeros((mesh.vertex_count, 3))
    distances = {"near": 0.001, "far": 0.004}

    def state(name: str, height: float, status: DrapeStatus) -> KeyedDrape:
        return KeyedDrape(Drape(mesh, flat + np.array([0.0, 0.0, height]), status, 1.0, 0.0, True, 3, 0.1, ""), name)

    moving, still = state("near", 0.001, DrapeStatus.NOT_STILL), state("near", 0.001, DrapeStatus.STILL)
    other = state("far", 0.02, DrapeStatus.STILL)
    by_height = {float(s.drape.vertices[0, 2]): distances[s.key] for s in (moving, other)}
    monkeypatch.setattr(
        base_state, "state_distance", lambda depth, drape, scene: by_height[float(drape.vertices[0, 2])]
    )
    simulator, scene = Simulator(DrapeCache(tmp_path)), SimulationScene(Setup.nominal("stretch"))
    monkeypatch.setattr(Simulator, "led", lambda *_: still if led_ends_there else other)
    candidates = [moving, other] if led_ends_there else [moving, still, other]
    found, rms = nearest_state(simulator, FABRIC, scene, np.ones((4, 4), np.float32), candidates)
    assert found.drape.ok and rms == 0.001
