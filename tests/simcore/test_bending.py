"""Bending: the stated rigidity in every direction, on every mesh, and Peirce's cantilever."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest

from simcore.bending import PlateRigidity
from simcore.grid import Grid
from simcore.mechanics import Mechanics
from simcore.parameters import FabricParameters
from simcore.scenes import GRAVITY_M_S2

from .closed_forms import cantilever, peirce_bending_length
from .rigs import ANISOTROPIC, FABRICS, Array, Level, Rig, cylinder, laid_out, stated_rigidity

HEADINGS = np.radians(np.arange(0.0, 180.0, 7.5))
PLATES = {
    "isotropic": FABRICS["medium"],
    "anisotropic": ANISOTROPIC,
    "stiff_bias": FabricParameters(900, 400, 150, 2e-5, 1e-5, 6e-5, 0.18),
    "soft_bias": FabricParameters(900, 400, 150, 6e-5, 2e-5, 0.6e-5, 0.18),
}


@cache
def sheet(cells: int, cell_m: float) -> Level:
    return Level(Grid(cells + 1, cells + 1, cell_m, cell_m))


def bending_energy(level: Level, fabric: FabricParameters, x: Array, off_grain: float = 0.0) -> float:
    """What the kernels give beyond the membrane and the weight [J]."""
    held = np.zeros(x.shape[:2], dtype=bool)
    rig = Rig.of(level, fabric, held, Mechanics(off_grain_rad=off_grain))
    return level.energy(x) + float(np.vdot(level.loads.force, x)) - float(rig.cloth.membrane_energy(x))


@pytest.mark.parametrize("plate", PLATES)
@pytest.mark.parametrize("cell_m", [0.01, 0.005])
def test_a_sample_rolled_up_along_any_direction_has_the_stated_rigidity(plate: str, cell_m: float) -> None:
    """Within 5 %; where the bias is a tenth of the warp, the free edges bend otherwise, by 6 % on 10 mm cells."""
    fabric, radius = PLATES[plate], 0.1
    within = 0.065 if plate == "soft_bias" and cell_m == 0.01 else 0.05
    level = sheet(round(0.5 / cell_m), cell_m)
    for heading in HEADINGS:
        energy = bending_energy(level, fabric, cylinder(level.grid, radius, heading))
        # heading counts from weft, the stated interpolation from warp
        expected = 0.5 * stated_rigidity(fabric, 0.5 * math.pi - heading) / radius**2 * 0.25
        assert energy == pytest.approx(expected, rel=within), f"{math.degrees(heading)}°"


@pytest.mark.parametrize("plate", ["anisotropic", "stiff_bias"])
@pytest.mark.parametrize("off_grain", [0.2, -0.7])
def test_off_grain_a_sample_has_the_rigidity_of_the_materials_direction(plate: str, off_grain: float) -> None:
    fabric, radius, level = PLATES[plate], 0.1, sheet(50, 0.01)
    felt = []
    for heading in HEADINGS:
        energy = bending_energy(level, fabric, cylinder(level.grid, radius, heading), off_grain)
        expected = stated_rigidity(fabric, 0.5 * math.pi - (heading - off_grain))
        felt.append(energy * 2.0 * radius**2 / 0.25)
        assert felt[-1] == pytest.approx(expected, rel=0.05), f"{math.degrees(heading)}°"
    mirrored = bending_energy(level, fabric, cylinder(level.grid, radius, -HEADINGS[4]), off_grain)
    assert abs(mirrored * 2.0 * radius**2 / 0.25 / felt[4] - 1.0) > 0.1  # the two diagonals are not alike


def bulk_rigidity(fabric: FabricParameters, cell_m: float, radius: float, heading: float) -> float:
    """Rigidity inside a sheet: E(n) = bulk n² + border n + corners, from three sheets of n cells [N·m]."""
    energies = [
        bending_energy(sheet(n, cell_m), fabric, cylinder(sheet(n, cell_m).grid, radius, heading)) for n in (8, 12, 16)
    ]
    bulk = (energies[2] - 2 * energies[1] + energies[0]) / (2.0 * (4 * cell_m) ** 2)
    return bulk * 2.0 * radius**2


@pytest.mark.parametrize("plate", PLATES)
def test_inside_a_sheet_the_rigidity_is_the_stated_one_to_second_order(plate: str) -> None:
    """Folds of 5 cm radius, 20 to 5 mm cells."""
    fabric = PLATES[plate]
    worst = [
        max(
            abs(bulk_rigidity(fabric, cell_m, 0.05, heading) / stated_rigidity(fabric, 0.5 * math.pi - heading) - 1)
            for heading in HEADINGS
        )
        for cell_m in (0.02, 0.01, 0.005)
    ]
    assert worst[0] < 0.05
    assert worst[1] < worst[0] / 3.5
    assert worst[2] < worst[1] / 3.5


@pytest.mark.parametrize(("cell_m", "radius", "within"), [(0.01, 0.02, 0.05), (0.005, 0.015, 0.02)])
@pytest.mark.parametrize("plate", PLATES)
def test_inside_a_sheet_narrow_folds_have_it_in_every_direction(
    plate: str, cell_m: float, radius: float, within: float
) -> None:
    """Folds of 2 cm radius on 10 mm cells, of 1.5 cm on 5 mm."""
    for heading in HEADINGS:
        stated = stated_rigidity(PLATES[plate], 0.5 * math.pi - heading)
        assert bulk_rigidity(PLATES[plate], cell_m, radius, heading) == pytest.approx(stated, rel=within)


def test_statement_of_the_plate() -> None:
    for fabric in PLATES.values():
        plate = PlateRigidity.of(fabric)
        assert plate.bias_raised is (fabric is PLATES["soft_bias"] and 4 * 0.6e-5 < (6e-5**0.5 - 2e-5**0.5) ** 2)
        for t in np.linspace(0, math.pi, 13):
            assert plate.along(t) == pytest.approx(stated_rigidity(fabric, t), rel=1e-12)
            assert plate.along(t) > 0.0
            # turned by t, the sample's own axes feel the rigidity of the material's direction
            assert plate.turned(t).warp == pytest.approx(stated_rigidity(fabric, t), rel=1e-12)
            assert plate.turned(t).weft == pytest.approx(stated_rigidity(fabric, t + 0.5 * math.pi), rel=1e-12)
            # and every other direction that of the one it lies along
            for heading in np.linspace(0, math.pi, 7):
                expected = stated_rigidity(fabric, heading + t)
                assert plate.turned(t).along(heading) == pytest.approx(expected, rel=1e-9)
    assert PlateRigidity.of(FABRICS["soft"]).bias_raised is False


def test_a_bias_rigidity_that_no_plate_has_is_raised_and_said() -> None:
    fabric = FabricParameters(900, 400, 150, 6e-5, 1e-6, 5e-6, 0.18)
    plate = PlateRigidity.of(fabric)
    assert plate.bias_raised
    assert plate.along(math.pi / 4) > fabric.bending_bias
    for t in np.linspace(0, math.pi, 181):
        assert plate.along(t) > 0.0
    assert plate.coupling**2 < plate.warp * plate.weft
    assert plate.twist >= 0.0


CANTILEVER = FabricParameters(3000, 2500, 800, 4e-4, 1.5e-4, 2e-4, 0.2)
WEIGHT = CANTILEVER.density * GRAVITY_M_S2


def droop(direction: str, cell_m: float, length_m: float, width_m: float = 0.2) -> tuple[float, float, float]:
    """Free length, reach and fall of the tip [m].

    Two held rows of vertices are a clamp half a cell before the second: the joint at it turns over a whole cell.
    """
    cells, across = round(length_m / cell_m), round(width_m / cell_m)
    if direction == "warp":
        level = Level(Grid(cells + 1, across + 1, cell_m, cell_m))
        flat, clamp = laid_out(level.grid, (0, 0, 1), (1, 0, 0)), np.s_[:2, :]
    else:
        level = Level(Grid(across + 1, cells + 1, cell_m, cell_m))
        flat, clamp = laid_out(level.grid, (1, 0, 0), (0, 0, 1)), np.s_[:, :2]
    held = np.zeros(flat.shape[:2], dtype=bool)
    held[clamp] = True
    mechanics = Mechanics(off_grain_rad=0.25 * math.pi if direction == "bias" else 0.0)
    x = Rig.of(level, CANTILEVER, held, mechanics).settle(flat)
    tip = (x[-1] if direction == "warp" else x[:, -1]).mean(axis=0)
    return length_m - 0.5 * cell_m, tip[0] - 0.5 * cell_m, -tip[1]


RIGIDITIES = {"warp": 4e-4, "weft": 1.5e-4, "bias": 2e-4}


@pytest.mark.parametrize("direction", RIGIDITIES)
@pytest.mark.parametrize("cell_m", [0.02, 0.01])
def test_cantilever_droops_as_the_elastica_and_as_peirce_says(direction: str, cell_m: float) -> None:
    rigidity = RIGIDITIES[direction]
    bending_length = (rigidity / WEIGHT) ** (1 / 3)
    length = cell_m * round(2.0 * bending_length / cell_m)  # falls by about 41.5°, as in the tester
    free, reach, fall = droop(direction, cell_m, length)
    x, y = cantilever(rigidity, WEIGHT, free)
    assert np.hypot(reach - x, fall + y) < 0.03 * free
    assert peirce_bending_length(free, fall, reach) == pytest.approx(bending_length, rel=0.03)


def test_a_long_soft_cantilever_hangs_as_the_elastica() -> None:
    free, reach, fall = droop("weft", 0.01, 0.2)
    x, y = cantilever(RIGIDITIES["weft"], WEIGHT, free)
    assert reach == pytest.approx(x, abs=0.01 * free)
    assert -fall == pytest.approx(y, abs=0.01 * free)
