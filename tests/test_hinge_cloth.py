"""The other simulator of ``bench`` is right enough to be held against: forces, stiffness in bending, weight."""

from __future__ import annotations

import importlib
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from diagnosis.scene import SimulationScene
from simcore.mechanics import UniformCurvature
from simcore.parameters import FabricParameters
from simcore.scenes import Scene, Setup

FABRIC = FabricParameters.from_mapping(
    {
        "stretch_warp": 800.0,
        "stretch_weft": 600.0,
        "stretch_bias": 200.0,
        "bending_warp": 6e-5,
        "bending_weft": 3e-5,
        "bending_bias": 4e-5,
        "density": 0.2,
    }
)
SCENE = SimulationScene(Setup.nominal(Scene.HANGING, pin_radius_m=0.0))


@pytest.fixture(scope="module")
def hinges() -> Iterator[Any]:
    """The modules, from their folder: ``bench`` is no package."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(Path(__file__).parents[1] / "bench"))
        yield importlib.import_module("hinge_cloth")


@pytest.fixture(scope="module")
def meshes(hinges: Any) -> Any:
    """The module of its triangulations."""
    return importlib.import_module("triangle_mesh")


@pytest.fixture(scope="module")
def mesh(meshes: Any) -> Any:
    """Cells of 20 mm."""
    return meshes.Mesh.of((0.5, 0.5), 0.02, 1)


def test_forces_are_the_energys_derivative(hinges: Any, mesh: Any) -> None:
    cloth = hinges.HingeCloth(mesh, FABRIC, SCENE.with_mechanics(stiffening_strain=0.03, off_grain_rad=0.1), 0)
    u, v = mesh.uv.T
    rng = np.random.default_rng(0)
    x = np.stack([1.02 * u, -v, 0.01 * np.sin(20 * u + 9 * v) + 0.02], 1) + 1e-4 * rng.standard_normal((len(u), 3))
    x[:5, 2] = 1e-4  # pressed to the panel
    direction = rng.standard_normal(x.shape)
    step = 1e-8
    change = (cloth.forces(x + step * direction)[0] - cloth.forces(x - step * direction)[0]) / (2 * step)
    assert change == pytest.approx(float((cloth.forces(x)[1] * direction).sum()), rel=1e-4)


STRONG_BIAS = FabricParameters.from_mapping({**FABRIC.as_dict(), "bending_bias": 1.2e-4})
WEAK_BIAS = FabricParameters.from_mapping({**FABRIC.as_dict(), "bending_bias": 1.2e-5})


@pytest.mark.parametrize("fabric", [FABRIC, STRONG_BIAS, WEAK_BIAS], ids=["usual", "strong bias", "weak bias"])
def test_a_cylinder_is_as_stiff_as_stated_along_every_direction(hinges: Any, mesh: Any, fabric: Any) -> None:
    cloth = hinges.HingeCloth(mesh, fabric, SCENE, 0)
    u, v = mesh.uv.T
    for t in math.pi / 8 * np.arange(8):
        angle = cloth._flat_angles(0.5 * (u * math.sin(t) + v * math.cos(t)) ** 2)[cloth.hinges]
        felt = float(np.einsum("ti,tij,tj->", angle, cloth.plate, angle)) / 0.25
        mixed = 4 * fabric.bending_bias - fabric.bending_warp - fabric.bending_weft
        c, s = math.cos(t) ** 2, math.sin(t) ** 2
        stated = fabric.bending_warp * c**2 + fabric.bending_weft * s**2 + mixed * s * c
        assert felt == pytest.approx(stated, rel=0.02)


def test_a_curved_sheet_wants_to_bend_towards_the_camera(hinges: Any, mesh: Any) -> None:
    curved = SCENE.with_mechanics(rest_curvature=(UniformCurvature(weft=5.0, warp=0.0),))
    cloth = hinges.HingeCloth(mesh, FABRIC, curved, 0)
    u, v = mesh.uv.T
    flat, bowl = (np.stack([u, -v, 0.01 + 0.5 * k * (u - 0.25) ** 2], 1) for k in (0.0, 0.5))
    assert cloth._bent(bowl, False)[0] < cloth._bent(flat, False)[0]


def test_it_comes_to_rest_in_front_of_the_panel(hinges: Any, meshes: Any) -> None:
    coarse = meshes.Mesh.of((0.5, 0.5), 0.04, 1)
    cloth = hinges.HingeCloth(coarse, FABRIC, SCENE, 3)
    x, left = cloth.drape()
    assert left < hinges.REST
    assert x[:, 2].min() > -1e-3
    assert x[cloth.held] == pytest.approx(cloth.home)
    assert -0.6 < x[:, 1].min() < -0.4


def test_a_rest_goes_on_where_it_was_on_finer_cells(hinges: Any, meshes: Any, mesh: Any) -> None:
    coarse = meshes.Mesh.of((0.5, 0.5), 0.04, 1)
    x, _ = hinges.HingeCloth(coarse, FABRIC, SCENE, 3).drape()
    start = meshes.carried(x, coarse, mesh)
    corners = [hinges.HingeCloth(m, FABRIC, SCENE, 3).held for m in (coarse, mesh)]
    assert start[corners[1]] == pytest.approx(x[corners[0]])
    cloth = hinges.HingeCloth(mesh, FABRIC, SCENE, 3)
    still, left = cloth.settle(start)
    assert left < hinges.REST
    assert cloth.forces(still)[0] < cloth.forces(start)[0]
    assert np.sqrt(((still - start) ** 2).sum(axis=1).mean()) < 0.03  # in the same folds


def test_physics_that_it_lacks_is_refused(hinges: Any, mesh: Any) -> None:
    with pytest.raises(ValueError, match="friction"):
        hinges.HingeCloth(mesh, FABRIC, SCENE.with_mechanics(friction=0.2), 0)
