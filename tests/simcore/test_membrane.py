"""The membrane: strips in a tensile tester, under their own weight, and a chain between two hooks."""

from __future__ import annotations

import math

import numpy as np
import pytest

from simcore.grid import Grid
from simcore.mechanics import Mechanics
from simcore.parameters import FabricParameters
from simcore.scenes import GRAVITY_M_S2

from .closed_forms import bias_modulus, catenary_sag, hanging_length, nominal_stress, stretch_under
from .rigs import ANISOTROPIC, Array, Level, Rig, laid_out, strip

WOVEN = FabricParameters(900, 400, 60, 1e-5, 1e-5, 1e-5, 0.005)


def pulled(fabric: FabricParameters, hem_kg_m: float, off_grain: float, cell_m: float, length: float = 0.5) -> Array:
    """A strip 40 mm wide that hangs by its top edge, with a bar along the bottom."""
    level = Level(Grid(round(length / cell_m) + 1, round(0.04 / cell_m) + 1, cell_m, cell_m))
    held = np.zeros((level.grid.rows, level.grid.columns), dtype=bool)
    held[0] = True
    rig = Rig.of(level, fabric, held, Mechanics(hem_kg_m=hem_kg_m, off_grain_rad=off_grain))
    return rig.settle(laid_out(level.grid, (1, 0, 0), (0, -1, 0)))


@pytest.mark.parametrize("cell_m", [0.02, 0.01])
@pytest.mark.parametrize("stiffness", [15.0, 200.0])
def test_strip_under_its_own_weight(cell_m: float, stiffness: float) -> None:
    fabric = FabricParameters(stiffness, 300, 100, 1e-5, 1e-5, 1e-5, 0.2)
    x = pulled(fabric, 0.0, 0.0, cell_m)
    longer = -x[-1, :, 1].mean() - 0.5
    assert longer == pytest.approx(hanging_length(stiffness, 0.2 * GRAVITY_M_S2, 0.5) - 0.5, rel=0.02)


@pytest.mark.parametrize(("off_grain", "stiffness"), [(0.0, 900.0), (0.5 * math.pi, 400.0)])
@pytest.mark.parametrize("hem_kg_m", [0.2, 4.0])
def test_uniaxial_strip_has_the_stated_stiffness(off_grain: float, stiffness: float, hem_kg_m: float) -> None:
    x = pulled(WOVEN, hem_kg_m, off_grain, 0.02)
    stretch = (-x[-1, :, 1].mean()) / 0.5
    force = hem_kg_m * GRAVITY_M_S2 + 0.5 * WOVEN.density * GRAVITY_M_S2 * 0.5
    assert nominal_stress(stiffness, stretch) == pytest.approx(force, rel=0.02)


@pytest.mark.parametrize("off_grain", [0.25 * math.pi, -0.25 * math.pi])
def test_bias_strip_has_the_stated_stiffness(off_grain: float) -> None:
    """Read on the middle third, as a tensile tester's extensometer does: the grip hinders narrowing."""
    x = pulled(WOVEN, 0.1, off_grain, 0.01)
    middle = x[17:34].mean(axis=1)
    stretch = float(np.linalg.norm(middle[-1] - middle[0])) / 0.16
    force = 0.1 * GRAVITY_M_S2
    stiffness = force / (stretch_under(1.0, force / bias_modulus(900, 400, 60)) - 1.0)  # small strain: near the modulus
    assert force / (stretch - 1.0) == pytest.approx(stiffness, rel=0.02)


def test_shear_costs_the_stated_bias_stiffness() -> None:
    level = Level(Grid(6, 6, 0.02, 0.02))
    held = np.zeros((6, 6), dtype=bool)
    Rig.of(level, ANISOTROPIC, held)
    flat = level.grid.rest
    for shear in (0.01, 0.1):
        # v fibres lean without changing length: 2 E_uv = sin(angle)
        x = flat.copy()
        x[..., 0] += math.sin(shear) * flat[..., 1]
        x[..., 1] *= math.cos(shear)
        energy = level.energy(x) + np.vdot(level.loads.force, x)
        assert energy == pytest.approx(0.5 * ANISOTROPIC.stretch_bias * math.sin(shear) ** 2 * 0.01, rel=1e-9)


def test_homogeneous_strain_is_the_stated_quadratic_form() -> None:
    level = Level(Grid(5, 7, 0.02, 0.03))
    Rig.of(level, ANISOTROPIC, np.zeros((5, 7), dtype=bool))
    flat = level.grid.rest
    area = 6 * 0.02 * 4 * 0.03
    rng = np.random.default_rng(3)
    for _ in range(5):
        a, b = np.eye(3)[0] + 0.1 * rng.standard_normal(3), -np.eye(3)[1] + 0.1 * rng.standard_normal(3)
        x = (flat[..., :1] - flat[0, 0, 0]) * a - flat[..., 1:2] * b
        e_uu, e_vv, shear = 0.5 * (a @ a - 1), 0.5 * (b @ b - 1), a @ b
        density = 0.5 * (400 * e_uu**2 + 900 * e_vv**2 + 150 * shear**2)
        energy = level.energy(x) + np.vdot(level.loads.force, x)
        assert energy == pytest.approx(density * area, rel=1e-9)


def test_a_twisted_sheet_is_not_stretched() -> None:
    """Isometries to first order cost no membrane energy: no cell locks when it is warped out of its plane."""
    level = Level(Grid(11, 11, 0.02, 0.02))
    rig = Rig.of(level, ANISOTROPIC, np.zeros((11, 11), dtype=bool))
    x = level.grid.rest.copy()
    twist = 0.5  # [1/m]: slopes up to 5 %
    x[..., 2] = twist * x[..., 0] * (x[..., 1] + 0.1)
    bending = 0.5 * 4 * rig.cloth.plate()[3] * twist**2 * 0.04
    assert float(rig.cloth.bending_energy(x)) == pytest.approx(bending, rel=1e-9)
    # what is left is the true strain of a saddle, fourth order in the slope
    u, v = x[:-1, :-1, 0] + 0.01, x[:-1, :-1, 1] + 0.09
    e_uu, e_vv, shear = 0.5 * (twist * v) ** 2, 0.5 * (twist * u) ** 2, twist**2 * u * v
    exact = 0.5 * np.sum(400 * e_uu**2 + 900 * e_vv**2 + 150 * shear**2) * 0.02**2
    assert float(rig.cloth.membrane_energy(x)) == pytest.approx(exact, rel=0.02)


@pytest.mark.parametrize("span", [0.45, 0.3])
def test_catenary_without_bending(span: float) -> None:
    level = strip(0.5, 0.08, 0.01)
    fabric = FabricParameters(1e5, 1e5, 1e4, 1e-8, 1e-8, 1e-8, 0.2)
    held = np.zeros((9, 51), dtype=bool)
    held[:, [0, -1]] = True
    # start from a parabola of about the right sag
    x = laid_out(level.grid, (1, 0, 0), (0, 0, 1))
    along = np.linspace(-1, 1, 51)
    x[..., 0] = 0.5 * span * along
    x[..., 1] = -catenary_sag(0.5, span) * 0.97 * (1 - along**2)
    rest = Rig.of(level, fabric, held).settle(x, tolerance=1e-4)
    sag = -rest[:, 25, 1]
    assert sag == pytest.approx(np.full(9, catenary_sag(0.5, span)), rel=0.01)
    assert np.abs(rest[..., 0] + rest[:, ::-1, 0]).max() < 1e-4
