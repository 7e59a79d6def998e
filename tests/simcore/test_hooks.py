"""Each optional mechanism against a closed form or a limiting case; pins that effects move have a file of their own."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from simcore.bending import PlateRigidity
from simcore.grid import Grid
from simcore.loads import rest_moments
from simcore.mechanics import (
    EDGES,
    Crease,
    CurvatureField,
    EdgeCurl,
    FrozenCurvature,
    Mechanics,
    UniformCurvature,
)
from simcore.parameters import FabricParameters
from simcore.scenes import GRAVITY_M_S2

from .closed_forms import stretch_under
from .reference import SLIP_M, Friction
from .rigs import ANISOTROPIC, Array, Level, Rig, crumpled, laid_out

STIFF = FabricParameters(1000, 800, 300, 1e-4, 1e-4, 1e-4, 0.005)


# -- rest curvature ----------------------------------------------------------------------------------------------


def relaxed(field: CurvatureField, columns: int = 21, rows: int = 11) -> Array:
    """A free sheet of 10 mm cells, almost weightless, held by three vertices in its middle, across its length."""
    level = Level(Grid(rows, columns, 0.01, 0.01))
    held = np.zeros((rows, columns), dtype=bool)
    if columns > rows:
        held[rows // 2 - 1 : rows // 2 + 2, columns // 2] = True
    else:
        held[rows // 2, columns // 2 - 1 : columns // 2 + 2] = True
    pull = (0.0, -0.01, 0.0) if columns > rows else (0.01, 0.0, 0.0)  # along the line that is held: it turns nothing
    rig = Rig.of(level, STIFF, held, Mechanics(gravity=pull, rest_curvature=(field,)))
    return rig.settle(level.grid.rest.copy(), tolerance=0.1)  # in weights a thousandth of the usual


@pytest.mark.parametrize("curvature", [10.0, -15.0])
def test_uniform_rest_curvature_is_taken_by_a_free_sheet(curvature: float) -> None:
    x = relaxed(UniformCurvature(weft=curvature))
    bend = np.diff(x, 2, axis=1) / 0.01**2
    assert np.linalg.norm(bend, axis=2) == pytest.approx(np.full((11, 19), abs(curvature)), rel=1e-3)
    assert np.linalg.norm(np.diff(x, 2, axis=0), axis=2).max() < 1e-3 * abs(curvature) * 0.01**2
    # positive: the ends come towards the camera
    assert math.copysign(1.0, x[5, 0, 2] - x[5, 10, 2]) == math.copysign(1.0, curvature)


def test_rest_curvature_along_warp_and_its_superposition() -> None:
    x = relaxed(UniformCurvature(warp=8.0), columns=11, rows=21)
    bend = np.linalg.norm(np.diff(x, 2, axis=0), axis=2) / 0.01**2
    assert bend == pytest.approx(np.full((19, 11), 8.0), rel=1e-3)
    level = Level(Grid(7, 9, 0.02, 0.02))
    free, state = np.zeros((7, 9), dtype=bool), crumpled(Grid(7, 9, 0.02, 0.02), 3)
    split = (UniformCurvature(3.0, 1.0), UniformCurvature(-1.0, 2.0))
    one = Rig.of(level, STIFF, free, Mechanics(rest_curvature=(UniformCurvature(2.0, 3.0),))).level.energy(state)
    assert Rig.of(level, STIFF, free, Mechanics(rest_curvature=split)).level.energy(state) == pytest.approx(one)


@pytest.mark.parametrize("angle", [0.8, -1.2])
def test_a_crease_folds_a_free_sheet_by_its_angle(angle: float) -> None:
    x = relaxed(Crease(angle, "warp", 0.5, 0.03), columns=21)
    left, right = x[5, 1] - x[5, 0], x[5, 20] - x[5, 19]
    turned = math.atan2(right[2], right[0]) - math.atan2(left[2], left[0])
    assert turned == pytest.approx(angle, rel=0.01)


def test_an_edge_curls_where_it_is_free_and_nowhere_else() -> None:
    field = EdgeCurl(30.0, 0.03, ("left",))
    u, v = np.meshgrid(np.linspace(0, 0.2, 21), np.linspace(0, 0.1, 11))
    weft, warp = field.evaluate(u, v, (0.2, 0.1))
    assert weft[:, 0] == pytest.approx(np.full(11, 30.0))
    assert not weft[:, 3:].any() and not warp.any()
    x = relaxed(EdgeCurl(30.0, 0.03, ("left", "right")))
    bend = np.linalg.norm(np.diff(x, 2, axis=1), axis=2) / 0.01**2
    assert bend[:, 0] == pytest.approx(np.full(11, 20.0), rel=0.02)  # one cell inside the edge
    assert bend[:, 5:-5].max() < 0.3
    assert x[5, 0, 2] > 0.0 and x[5, 20, 2] > 0.0


def test_curvature_left_by_handling_has_the_stated_size_and_no_mesh() -> None:
    field = FrozenCurvature(5.0, seed=4)
    fine = field.evaluate(*np.meshgrid(np.linspace(0, 2, 401), np.linspace(0, 2, 401)), (2.0, 2.0))
    coarse = field.evaluate(*np.meshgrid(np.linspace(0, 2, 101), np.linspace(0, 2, 101)), (2.0, 2.0))
    for a, b in zip(fine, coarse, strict=True):
        assert float(np.sqrt(np.mean(a**2))) == pytest.approx(5.0, rel=0.15)
        assert np.array_equal(a[::4, ::4], b) or np.allclose(a[::4, ::4], b, atol=1e-9)
    other = FrozenCurvature(5.0, seed=5).evaluate(*np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 9)), (1.0, 1.0))
    assert not np.allclose(other[0], fine[0][:9, :9])


@pytest.mark.parametrize("seed", [2, 4, 9])
def test_curvature_left_by_handling_that_hardly_varies_is_taken_by_a_free_strip(seed: int) -> None:
    """Waves of 50 m over 0.2 m: one curvature, as that of a roll; of seeds that make no saddle, which stretches it."""
    field = FrozenCurvature(8.0, seed=seed, wavelength_m=50.0)
    curvatures = field.evaluate(np.array([0.1]), np.array([0.01]), (0.2, 0.02))
    weft, warp = (float(values[0]) for values in curvatures)
    x = relaxed(field, rows=3)
    ends = np.r_[0:6, 13:19]  # away from the line in the middle that is held straight
    along = np.linalg.norm(np.diff(x, 2, axis=1), axis=2)[:, ends] / 0.01**2
    across = np.linalg.norm(np.diff(x, 2, axis=0), axis=2)[:, 1 + ends] / 0.01**2
    assert along == pytest.approx(np.full(along.shape, abs(weft)), rel=0.03, abs=0.1)
    assert across == pytest.approx(np.full(across.shape, abs(warp)), rel=0.03, abs=0.1)
    assert max(abs(weft), abs(warp)) > 2.0


@pytest.mark.parametrize("cell", [0.005, 0.01, 0.02, 0.025, 0.05])
@pytest.mark.parametrize("position", [0.5, 0.55])
def test_a_crease_has_its_angle_on_any_cells(cell: float, position: float) -> None:
    count = round(0.5 / cell) + 1
    grid = Grid(count, count, cell, cell)
    plate = PlateRigidity.of(STIFF)
    moments = rest_moments(grid, plate, Mechanics(rest_curvature=(Crease(1.2, position=position),)))
    assert moments is not None
    angle = moments[count // 2, :, 0].sum() * cell**2 / (plate.weft * cell * cell) * cell
    assert angle == pytest.approx(1.2, rel=0.02)


@pytest.mark.parametrize("cell", [0.005, 0.01, 0.0125, 0.02, 0.025, 0.05])
@pytest.mark.parametrize("width", [0.025, 0.045])
def test_an_edge_curl_lifts_a_free_edge_alike_on_any_cells(cell: float, width: float) -> None:
    """A strip bent by little: its end rises by the moment of the curvature about it, w² kappa / 6."""
    count = round(0.5 / cell) + 1
    grid, plate = Grid(count, count, cell, cell), PlateRigidity.of(STIFF)
    moments = rest_moments(grid, plate, Mechanics(rest_curvature=(EdgeCurl(20.0, width, ("left",)),)))
    assert moments is not None
    turns = moments[count // 2, :, 0] * cell**2 / (plate.weft * cell * cell) * cell
    rise = float((turns * cell * np.arange(count)).sum())
    assert rise == pytest.approx(20.0 * width**2 / 6.0, rel=0.01)


# -- weight, draft, tilt, hem ------------------------------------------------------------------------------------


def hung(mechanics: Mechanics) -> Array:
    """A limp strip 0.4 m long held along its top edge."""
    fabric = FabricParameters(1000, 800, 300, 1e-8, 1e-8, 1e-8, 0.15)
    level = Level(Grid(21, 4, 0.02, 0.02))
    held = np.zeros((21, 4), dtype=bool)
    held[0] = True
    rig = Rig.of(level, fabric, held, mechanics)
    return rig.settle(laid_out(level.grid, (1, 0, 0), (0, -0.9, 0.1)))


@pytest.mark.parametrize("pressure", [0.5, -0.3])
def test_a_limp_strip_in_a_draft_hangs_along_the_resultant(pressure: float) -> None:
    x = hung(Mechanics(air_pressure_pa=pressure))
    slope = pressure / (0.15 * GRAVITY_M_S2)
    assert x[1:, :, 2] / -x[1:, :, 1] == pytest.approx(np.full((20, 4), slope), abs=1e-3)


@pytest.mark.parametrize("tilt_deg", [10.0, -14.0])
def test_tilt_is_gravity_turned_and_equals_a_draft_with_less_weight(tilt_deg: float) -> None:
    tilt = math.radians(tilt_deg)
    g = GRAVITY_M_S2
    tilted = Mechanics(gravity=(0.0, -g * math.cos(tilt), -g * math.sin(tilt)))
    x = hung(tilted)
    assert -x[1:, :, 2] / -x[1:, :, 1] == pytest.approx(np.full((20, 4), math.tan(tilt)), abs=1e-3)
    level = Level(Grid(5, 5, 0.02, 0.02))
    held = np.zeros((5, 5), dtype=bool)
    a = Rig.of(level, ANISOTROPIC, held, tilted).level.loads.force
    draft = Mechanics((0.0, -g * math.cos(tilt), 0.0), -ANISOTROPIC.density * g * math.sin(tilt))
    b = Rig.of(level, ANISOTROPIC, held, draft).level.loads.force
    assert a == pytest.approx(b, rel=1e-14)


def test_weights_add_up() -> None:
    level = Level(Grid(6, 9, 0.02, 0.03))
    held = np.zeros((6, 9), dtype=bool)
    load = Rig.of(level, ANISOTROPIC, held, Mechanics(hem_kg_m=0.05, air_pressure_pa=0.4)).level.loads
    area, edge = 8 * 0.02 * 5 * 0.03, 8 * 0.02
    mass = ANISOTROPIC.density * area + 0.05 * edge
    assert load.mass.sum() == pytest.approx(mass, rel=1e-12)
    assert load.force.sum(axis=(0, 1)) == pytest.approx([0.0, -mass * GRAVITY_M_S2, 0.4 * area], rel=1e-12)
    assert (load.mass[-1] > 1.5 * load.mass[0]).all()  # at the bottom
    assert load.weight == pytest.approx(ANISOTROPIC.density * GRAVITY_M_S2 * 0.02 * 0.03, rel=1e-12)


@pytest.mark.parametrize(("number", "name"), list(enumerate(EDGES)))
def test_a_trim_weighs_along_its_own_edge(number: int, name: str) -> None:
    level = Level(Grid(6, 9, 0.02, 0.03))
    held = np.zeros((6, 9), dtype=bool)
    trim = tuple(0.05 * (k == number) for k in range(len(EDGES)))
    plain, load = (Rig.of(level, ANISOTROPIC, held, Mechanics(trim_kg_m=t)).level.loads for t in ((0.0,) * 4, trim))
    added = load.mass - plain.mass
    where = {"left": np.s_[:, 0], "right": np.s_[:, -1], "top": np.s_[0], "bottom": np.s_[-1]}[name]
    length = 5 * 0.03 if name in ("left", "right") else 8 * 0.02
    assert added[where].sum() == pytest.approx(0.05 * length, rel=1e-12) == added.sum()
    assert added[where][[0, -1]] == pytest.approx(0.5 * added[where][1], rel=1e-12)


# -- membrane ----------------------------------------------------------------------------------------------------


def strained(level: Level, fabric: FabricParameters, mechanics: Mechanics, weft: float, warp: float) -> float:
    """Energy per area of a homogeneous Green-Lagrange strain [J/m²]."""
    grid = level.grid
    Rig.of(level, fabric, np.zeros((grid.rows, grid.columns), dtype=bool), mechanics)
    x = grid.rest * [math.sqrt(1 + 2 * weft), math.sqrt(1 + 2 * warp), 1.0]
    return (level.energy(x) + float(np.vdot(level.loads.force, x))) / grid.areas.sum()


@pytest.mark.parametrize("limit", [0.015, 0.08])
def test_stiffening_doubles_the_tensile_modulus_at_the_stated_strain(limit: float) -> None:
    level = Level(Grid(5, 5, 0.02, 0.02))
    stiffening, plain = Mechanics(stiffening_strain=limit), Mechanics()

    def modulus(mechanics: Mechanics, strain: float, warp: bool) -> float:
        d = 1e-2 * limit
        energies = [
            strained(level, ANISOTROPIC, mechanics, *((0.0, strain + s) if warp else (strain + s, 0.0)))
            for s in (-d, 0.0, d)
        ]
        return (energies[0] - 2 * energies[1] + energies[2]) / d**2

    for warp, stated in ((True, 900.0), (False, 400.0)):
        assert modulus(stiffening, limit, warp) == pytest.approx(2 * stated, rel=1e-3)
        assert modulus(plain, limit, warp) == pytest.approx(stated, rel=1e-6)
        assert modulus(stiffening, -limit, warp) == pytest.approx(stated, rel=1e-6)  # not in compression
    assert strained(level, ANISOTROPIC, stiffening, -0.02, -0.02) == strained(level, ANISOTROPIC, plain, -0.02, -0.02)


def test_a_stiffening_strip_carries_the_load_of_its_curve() -> None:
    fabric, limit, hem = FabricParameters(100, 100, 30, 1e-5, 1e-5, 1e-5, 0.005), 0.03, 0.6
    level = Level(Grid(26, 3, 0.02, 0.02))
    held = np.zeros((26, 3), dtype=bool)
    held[0] = True
    rig = Rig.of(level, fabric, held, Mechanics(stiffening_strain=limit, hem_kg_m=hem))
    x = rig.settle(laid_out(level.grid, (1, 0, 0), (0, -1, 0)))
    stretch = -x[-1, :, 1].mean() / 0.5
    strain = 0.5 * (stretch**2 - 1)
    carried = stretch * 100 * (strain + strain**3 / (3 * limit**2))
    assert carried == pytest.approx((hem + 0.5 * 0.005 * 0.5) * GRAVITY_M_S2, rel=0.01)
    assert stretch < stretch_under(100, hem * GRAVITY_M_S2)


@pytest.mark.parametrize("quarter_turns", [1, -1])
def test_off_grain_by_a_right_angle_swaps_warp_and_weft(quarter_turns: int) -> None:
    swapped = replace(
        ANISOTROPIC, stretch_warp=ANISOTROPIC.stretch_weft, stretch_weft=ANISOTROPIC.stretch_warp,
        bending_warp=ANISOTROPIC.bending_weft, bending_weft=ANISOTROPIC.bending_warp,
    )  # fmt: skip
    grid = Grid(9, 9, 0.02, 0.02)
    level, held = Level(grid), np.zeros((9, 9), dtype=bool)
    # smooth and large, without the hourglass that belongs to cells and not to yarns
    x = grid.rest.copy()
    u, v = grid.rest[..., 0], grid.rest[..., 1]
    x[..., 0] *= 1.03
    x[..., 1] += 0.04 * u - 0.02 * v
    x[..., 2] = 0.02 * np.sin(20 * u) + 0.01 * np.sin(25 * v)
    a = Rig.of(level, ANISOTROPIC, held, Mechanics(off_grain_rad=quarter_turns * 0.5 * math.pi)).level.gradient(x)
    b = Rig.of(level, swapped, held).level.gradient(x)
    assert np.abs(a - b).max() < 1e-9 * np.abs(b).max()


def test_off_grain_turns_weft_towards_v() -> None:
    """Stretched along the turned weft the cloth is as stiff as its weft, along the mirrored direction it is not."""
    angle = 0.3
    level = Level(Grid(5, 5, 0.02, 0.02))
    Rig.of(level, replace(ANISOTROPIC, stretch_bias=50.0), np.zeros((5, 5), bool), Mechanics(off_grain_rad=angle))
    u, v = level.grid.rest[..., 0], -level.grid.rest[..., 1]
    energies = []
    for heading in (angle, -angle):
        d = np.array([math.cos(heading), math.sin(heading)])
        along = (u * d[0] + v * d[1]) * (math.sqrt(1.02) - 1.0)
        x = level.grid.rest.copy()
        x[..., 0] += along * d[0]
        x[..., 1] -= along * d[1]
        energies.append(level.energy(x) + float(np.vdot(level.loads.force, x)))
    assert energies[0] == pytest.approx(0.5 * ANISOTROPIC.stretch_weft * 0.01**2 * level.grid.areas.sum(), rel=1e-9)
    assert energies[1] != pytest.approx(energies[0], rel=0.05)


# -- panel -------------------------------------------------------------------------------------------------------


def test_adhesion_pulls_with_the_stated_pressure_at_most() -> None:
    pressure, reach = 2.0, 3e-3
    level = Level(Grid(5, 5, 0.02, 0.02))
    held = np.zeros((5, 5), dtype=bool)
    sticky = Mechanics(adhesion_pa=pressure, adhesion_range_m=reach)
    heights = np.linspace(0.2e-3, 4e-3, 400)
    pulls = []
    for z in heights:
        x = np.add(level.grid.rest, [0.0, 0.0, z])
        with_it = Rig.of(level, ANISOTROPIC, held, sticky, panel=True).level.gradient(x)
        without = Rig.of(level, ANISOTROPIC, held, panel=True).level.gradient(x)
        pulls.append((with_it - without)[..., 2].sum() / level.grid.areas.sum())
    assert min(pulls) >= 0.0
    assert max(pulls) == pytest.approx(pressure, rel=1e-3)
    assert heights[int(np.argmax(pulls))] == pytest.approx(reach / math.sqrt(3.0), abs=2e-5)
    assert not np.any(np.array(pulls)[heights > reach])


@pytest.mark.parametrize(("lift", "sticks"), [(0.9, True), (1.1, False)])
def test_a_draft_tears_off_what_adhesion_cannot_hold(lift: float, sticks: bool) -> None:
    fabric = FabricParameters(1000, 800, 300, 1e-6, 1e-6, 1e-6, 0.15)
    level = Level(Grid(11, 4, 0.02, 0.02))
    held = np.zeros((11, 4), dtype=bool)
    held[0] = True
    mechanics = Mechanics(adhesion_pa=1.0, air_pressure_pa=lift)
    x = np.add(laid_out(level.grid, (1, 0, 0), (0, -1, 0)), [0.0, 0.0, 1e-3])
    rest = Rig.of(level, fabric, held, mechanics, panel=True).settle(x)
    assert bool(rest[-1, :, 2].max() < 2e-3) is sticks
    if sticks:  # pull = draft: between the barrier and the steepest slope
        t = rest[5, 2, 2] / 3e-3
        assert 1 / 3 < t < 1 / math.sqrt(3)
        assert 3 * math.sqrt(3) / 8 * 4 * t * (1 - t * t) == pytest.approx(lift, rel=0.02)


PRESS_PA = 4.0
LYING = FabricParameters(1000, 800, 300, 1e-5, 1e-5, 1e-5, 0.1)


@pytest.fixture(scope="module")
def small() -> Level:
    return Level(Grid(6, 6, 0.02, 0.02))


def lying(level: Level, coefficient: float) -> tuple[Rig, Array, float]:
    """A free sheet pressed to an upright panel, where it starts, and its weight as a share of the most friction."""
    grid = level.grid
    friction = Friction(coefficient * PRESS_PA * grid.areas, grid.rest[..., :2])
    draft = Mechanics(air_pressure_pa=-PRESS_PA)
    rig = Rig.of(level, LYING, np.zeros((6, 6), dtype=bool), draft, panel=True, friction=friction)
    share = LYING.density * GRAVITY_M_S2 / (coefficient * PRESS_PA)
    return rig, np.add(grid.rest, [0.0, -1e-5, 8e-4]), share


@pytest.mark.parametrize("coefficient", [0.3, 0.5, 2.0])
def test_friction_that_can_carry_the_weight_holds_the_sheet_a_little_lower(coefficient: float, small: Level) -> None:
    rig, start, share = lying(small, coefficient)
    grid = rig.level.grid
    assert share < 1.0
    rest = rig.settle(start)
    shift = SLIP_M * share / math.sqrt(1 - share**2)
    assert grid.rest[..., 1] - rest[..., 1] == pytest.approx(np.full((6, 6), shift), rel=1e-2)
    pushed = rig.level.contact.normal_force(rest, rig.level.fixed)
    assert pushed == pytest.approx(PRESS_PA * grid.areas, rel=1e-3)


@pytest.mark.parametrize("coefficient", [0.1, 0.2])
def test_beyond_its_limit_friction_lets_the_sheet_slip(coefficient: float, small: Level) -> None:
    """However far it has slipped, friction takes its most off the weight and the rest pulls on downwards."""
    rig, start, share = lying(small, coefficient)
    areas = rig.level.grid.areas
    assert share > 1.0
    for slipped in (0.0, 1e-3, 1e-2, 1.0):
        gradient = rig.level.gradient(np.subtract(start, [0.0, slipped, 0.0]))
        assert gradient[..., 1].sum() > 0.0  # energy falls on the way down
    left = gradient[..., 1].sum() / areas.sum()
    assert left == pytest.approx(LYING.density * GRAVITY_M_S2 - coefficient * PRESS_PA, rel=1e-3)
