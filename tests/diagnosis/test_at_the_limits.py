"""Fabrics at the ends of what may be, and samples of few cells, are varied where they can be."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from diagnosis.scene import SimulationScene
from diagnosis.simulation.drape_cache import DrapeCache
from diagnosis.simulation.simulator import Simulator
from diagnosis.simulation.variations import PARAMETER_STEP, stepped
from diagnosis.synthesis import misstate
from simcore.errors import SimulationError
from simcore.mesh import GridMesh
from simcore.parameters import LIMITS, PARAMETER_NAMES, FabricParameters
from simcore.scenes import Setup

FABRIC = FabricParameters(1000.0, 800.0, 300.0, 1e-5, 1e-5, 1e-5, 0.2)


@pytest.mark.parametrize("index", range(7))
def test_a_parameter_is_changed_upwards_and_at_its_upper_limit_downwards(index: int) -> None:
    changed, step = stepped(FABRIC, index)
    assert step == PARAMETER_STEP
    assert changed.as_array()[index] == pytest.approx((1 + step) * FABRIC.as_array()[index])
    values = FABRIC.as_array()
    values[index] = LIMITS[PARAMETER_NAMES[index]][1]
    changed, step = stepped(FabricParameters.from_array(values), index)
    assert step == -PARAMETER_STEP
    assert changed.as_array()[index] == pytest.approx((1 + step) * values[index])


def test_a_fabric_about_which_none_is_stable_cannot_be_misstated() -> None:
    stable = misstate(FABRIC, 0.07, 0.02, np.random.default_rng(1))
    assert stable != FABRIC
    twisting = FabricParameters(1000.0, 800.0, 300.0, 1e-4, 1e-6, 1e-6, 0.2)
    with pytest.raises(SimulationError, match="state a larger bending_bias") as caught:
        misstate(twisting, 0.07, 0.02, np.random.default_rng(1))
    assert caught.value.code == "fabric_not_stable"


@pytest.mark.parametrize(("cell_m", "size_m"), [(0.025, 0.1), (0.0625, 0.5)])
def test_where_there_is_no_mesh_of_twice_the_cell_a_state_stays_its_own(
    cell_m: float, size_m: float, tmp_path: Path
) -> None:
    mesh = GridMesh(cell_m, (size_m, size_m))
    simulator, scene = Simulator(DrapeCache(tmp_path)), SimulationScene(Setup.nominal("hanging"))
    state = simulator.shaped(mesh, 0.0 * mesh.material_coordinates[:, [0, 1, 1]])
    assert simulator.coarser(state, FABRIC, scene) is state
