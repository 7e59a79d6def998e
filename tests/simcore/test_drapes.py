"""Whole drapes, judged from outside: at rest, stable, in front of the panel, on their pins, repeatable."""

from __future__ import annotations

import itertools
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from simcore.drape import Drape, DrapeStatus
from simcore.mechanics import (
    NO_JITTER,
    Crease,
    EdgeCurl,
    FrozenCurvature,
    Jitter,
    Mechanics,
    UniformCurvature,
)
from simcore.mesh import GridMesh
from simcore.placement import STEPS
from simcore.scenes import Scene, Setup
from simcore.self_contact import APART, TUCKED
from simcore.solver import Solver

from .conftest import CASES
from .judge import cloth_of, held_places, lowest_stiffness, positions
from .reference import Friction
from .rigs import FABRICS

Drapes = dict[tuple[str, Scene], Drape]


def depth_difference_mm(a: Drape, b: Drape) -> float:
    return 1e3 * float(np.sqrt(np.mean((a.vertices[:, 2] - b.vertices[:, 2]) ** 2)))


@pytest.mark.parametrize(("name", "scene"), CASES)
def test_drapes_are_at_rest_and_stable(name: str, scene: Scene, drapes: Drapes) -> None:
    drape, setup = drapes[name, scene], Setup.nominal(scene)
    assert drape.status is DrapeStatus.STILL, drape.reason
    assert drape.ok and drape.stable and drape.reason == ""
    x = positions(drape)
    # on some machines a soft drape comes to touch itself, and contact of its parts is a part of its energy
    judges = [cloth_of(drape, FABRICS[name], setup, own_contact=apart) for apart in (0, APART, TUCKED)]
    cloth = min(judges, key=lambda judge: abs(judge.energy(x) - drape.energy))
    assert cloth.residual(x) < 1e-3
    assert cloth.residual(x) == pytest.approx(drape.residual, rel=1e-3, abs=1e-7)
    assert cloth.energy(x) == pytest.approx(drape.energy, rel=1e-9)
    assert lowest_stiffness(cloth, x) > -1e-6
    # gravity did it: below where it began, neither torn nor folded to nothing
    assert drape.energy < 0.0 or scene is Scene.STRETCH
    strain = np.concatenate([np.linalg.norm(np.diff(x, axis=k), axis=2).ravel() for k in (0, 1)]) / 0.02
    assert strain.min() > 0.5 and strain.max() < 1.5


@pytest.mark.parametrize(("name", "scene"), CASES)
def test_nothing_is_behind_the_panel_and_pins_hold(name: str, scene: Scene, drapes: Drapes) -> None:
    drape, setup = drapes[name, scene], Setup.nominal(scene)
    held, places = held_places(drape, setup, Jitter(), 0)
    x = positions(drape)
    assert held.sum() == len(setup.pins_m)
    assert x[held] == pytest.approx(places[held], abs=1e-15)
    assert x[..., 2][~held].min() > 0.0
    # a jittered pin stays within two and a half deviations along x and y, and on the panel
    nominal = np.array(list(setup.pins_m.values()))
    moved = np.array([x[j, i] for j, i in ((0, 0), (0, -1), (-1, -1))][: len(nominal)]) - nominal
    assert np.abs(moved).max() <= 0.0025 + 1e-12
    assert not moved[:, 2].any()


def test_a_patch_of_cloth_is_held_flat_within_the_radius(solver: Solver) -> None:
    setup = Setup.nominal(Scene.HANGING, pin_radius_m=0.045)
    drape = solver.solve(FABRICS["medium"], setup, seed=3)
    held, places = held_places(drape, setup, Jitter(), 3)
    assert held.sum() == 16  # per corner: 3 + 3 + 2 vertices of 20 mm cells within 45 mm
    assert drape.ok
    assert positions(drape)[held] == pytest.approx(places[held], abs=1e-15)
    assert cloth_of(drape, FABRICS["medium"], setup, seed=3).residual(positions(drape)) < 1e-3


def test_same_seed_same_bits_whatever_was_solved_between(solver: Solver, drapes: Drapes) -> None:
    setup = Setup.nominal(Scene.HANGING)
    again = solver.solve(FABRICS["stiff"], setup, seed=0)
    assert np.array_equal(again.vertices, drapes["stiff", Scene.HANGING].vertices)
    assert again.energy == drapes["stiff", Scene.HANGING].energy
    solver.solve(FABRICS["soft"], Setup.nominal(Scene.STRETCH), seed=5, mechanics=Mechanics(hem_kg_m=0.01))
    third = solver.solve(FABRICS["stiff"], setup, seed=np.random.SeedSequence(0))
    assert np.array_equal(again.vertices, third.vertices)


def test_same_seed_same_bits_in_another_process(drapes: Drapes, repository: Path) -> None:
    script = (
        "import hashlib\n"
        "from simcore.mesh import GridMesh\nfrom simcore.parameters import FabricParameters\n"
        "from simcore.scenes import Setup\nfrom simcore.solver import Solver\n"
        f"fabric = FabricParameters.from_array({FABRICS['stiff'].as_array().tolist()})\n"
        "drape = Solver(GridMesh(0.02)).solve(fabric, Setup.nominal('hanging'))\n"
        "print(hashlib.sha256(drape.vertices.tobytes()).hexdigest())\n"
    )
    import hashlib

    done = subprocess.run([sys.executable, "-c", script], cwd=repository, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == hashlib.sha256(drapes["stiff", Scene.HANGING].vertices.tobytes()).hexdigest()


@pytest.mark.parametrize("name", ["stiff", "medium"])
def test_other_seeds_give_other_drapes(name: str, solver: Solver, drapes: Drapes) -> None:
    other = solver.solve(FABRICS[name], Setup.nominal(Scene.HANGING), seed=1)
    assert other.ok
    assert 0.3 < depth_difference_mm(other, drapes[name, Scene.HANGING]) < 60.0


def test_mirrored_pins_give_the_mirrored_drape(solver: Solver) -> None:
    nominal = Setup.nominal(Scene.HANGING)
    left = nominal.with_pins(top_left=(-0.205, 0.004, 0.0), top_right=(0.19, 0.0, 0.0))
    right = nominal.with_pins(top_left=(-0.19, 0.0, 0.0), top_right=(0.205, 0.004, 0.0))
    # softer fabrics rest in several shapes, and with nothing random the last bits choose among them
    a = solver.solve(FABRICS["vstiff"], left, jitter=NO_JITTER)
    b = solver.solve(FABRICS["vstiff"], right, jitter=NO_JITTER)
    assert a.ok and b.ok
    mirrored = positions(b)[:, ::-1] * [-1.0, 1.0, 1.0]
    assert np.abs(positions(a) - mirrored).max() < 1e-4
    assert a.energy == pytest.approx(b.energy, rel=1e-7)


def test_a_mirrored_drape_is_at_rest_between_mirrored_pins(solver: Solver) -> None:
    nominal = Setup.nominal(Scene.HANGING)
    left = nominal.with_pins(top_left=(-0.205, 0.004, 0.0), top_right=(0.19, 0.0, 0.0))
    right = nominal.with_pins(top_left=(-0.19, 0.0, 0.0), top_right=(0.205, 0.004, 0.0))
    a = solver.solve(FABRICS["stiff"], left, jitter=NO_JITTER)
    mirrored = positions(a)[:, ::-1] * [-1.0, 1.0, 1.0]
    start = replace(a, vertices=np.ascontiguousarray(mirrored).reshape(-1, 3))
    b = solver.solve(FABRICS["stiff"], right, jitter=NO_JITTER, start=start)
    assert a.ok and b.ok
    assert np.abs(positions(b) - mirrored).max() < 1e-4
    assert a.energy == pytest.approx(b.energy, rel=1e-7)


def test_a_symmetric_problem_has_a_symmetric_drape(solver: Solver) -> None:
    drape = solver.solve(FABRICS["vstiff"], Setup.nominal(Scene.HANGING), jitter=NO_JITTER)
    x = positions(drape)
    assert drape.ok
    assert np.abs(x - x[:, ::-1] * [-1.0, 1.0, 1.0]).max() < 1e-4


def test_mechanics_of_magnitude_zero_are_the_baseline_bit_by_bit(solver: Solver, drapes: Drapes) -> None:
    zeros = Mechanics(
        air_pressure_pa=0.0, off_grain_rad=0.0, stiffening_strain=None, rest_curvature=(UniformCurvature(),),
        hem_kg_m=0.0, adhesion_pa=0.0, adhesion_range_m=5e-3, friction=0.0,
    )  # fmt: skip
    drape = solver.solve(FABRICS["stiff"], Setup.nominal(Scene.HANGING), mechanics=zeros)
    assert np.array_equal(drape.vertices, drapes["stiff", Scene.HANGING].vertices)


HOOKS = {
    "draft": Mechanics(air_pressure_pa=0.4),
    "tilt": Mechanics(gravity=(0.0, -9.7, -1.5)),
    "off_grain": Mechanics(off_grain_rad=0.2),
    "stiffening": Mechanics(stiffening_strain=0.02),
    "roll": Mechanics(rest_curvature=(UniformCurvature(6.0, 0.0),)),
    "edge_curl": Mechanics(rest_curvature=(EdgeCurl(40.0),)),
    "crease": Mechanics(rest_curvature=(Crease(0.8),)),
    "hysteresis": Mechanics(rest_curvature=(FrozenCurvature(4.0),)),
    "hem": Mechanics(hem_kg_m=0.02),
    "adhesion": Mechanics(adhesion_pa=1.0),
    "friction": Mechanics(friction=0.4),
}


@pytest.mark.parametrize("hook", HOOKS)
def test_every_hook_comes_to_rest_and_shows(hook: str, solver: Solver, drapes: Drapes) -> None:
    setup, mechanics, fabric = Setup.nominal(Scene.STRETCH), HOOKS[hook], FABRICS["medium"]
    drape = solver.solve(fabric, setup, mechanics=mechanics)
    assert drape.ok, drape.reason
    friction = None
    if mechanics.friction:
        contact = solver.levels[-1].contact
        assert contact.friction_force is not None and contact.anchor is not None
        friction = Friction(contact.friction_force, contact.anchor)
    cloth = cloth_of(drape, fabric, setup, mechanics, friction=friction)
    assert cloth.residual(positions(drape)) < 1e-3
    assert lowest_stiffness(cloth, positions(drape)) > -1e-6
    assert depth_difference_mm(drape, drapes["medium", Scene.STRETCH]) > 0.02


@pytest.mark.parametrize("scene", Scene)
def test_friction_holds_what_presses_at_rest_and_nothing_else(scene: Scene, solver: Solver) -> None:
    drape = solver.solve(FABRICS["medium"], Setup.nominal(scene), mechanics=Mechanics(friction=0.4), seed=2)
    assert drape.ok, drape.reason
    level, x = solver.levels[-1], positions(drape)
    bound, push = level.contact.friction_force, level.contact.normal_force(x, level.fixed)
    assert bound is not None and push.sum() > 0.0
    assert np.abs(bound - 0.4 * push).sum() < 0.06 * 0.4 * push.sum()
    assert bound[x[..., 2] > 1.5e-3].sum() < 0.02 * bound.sum()


def test_friction_of_a_drape_that_is_continued_changes_little(solver: Solver, drapes: Drapes) -> None:
    """The panel holds a drape where it rests already."""
    first = drapes["medium", Scene.STRETCH]
    setup = Setup.nominal(Scene.STRETCH)
    held = solver.solve(FABRICS["medium"], setup, start=first, jitter=NO_JITTER, mechanics=Mechanics(friction=0.4))
    free = solver.solve(FABRICS["medium"], setup, start=first, jitter=NO_JITTER)
    assert held.ok and free.ok
    away = [np.abs(d.vertices - first.vertices).max() for d in (held, free)]
    assert away[0] <= away[1] + 1e-4


def test_more_pressure_on_the_panel_means_more_contact(solver: Solver) -> None:
    setup = Setup.nominal(Scene.HANGING)
    pressed, blown = (
        solver.solve(FABRICS["vstiff"], setup, mechanics=Mechanics(air_pressure_pa=p)).vertices[:, 2]
        for p in (-1.0, 1.0)
    )
    assert pressed.mean() < 0.5 * blown.mean()
    assert (pressed < 1e-3).sum() > (blown < 1e-3).sum()


def test_weight_is_carried_by_pins_and_panel(drapes: Drapes) -> None:
    """Forces on all vertices add up to what the pins hold: gravity down, the panel's push out."""
    drape = drapes["medium", Scene.HANGING]
    cloth, x = cloth_of(drape, FABRICS["medium"], Setup.nominal(Scene.HANGING)), positions(drape)
    everything = replace(cloth, held=np.zeros_like(cloth.held))
    inner = everything.membrane_gradient(x) + everything.bending_gradient(x)
    assert np.abs(inner.sum(axis=(0, 1))).max() < 1e-9
    weight = 0.2 * 9.81 * 0.25
    carried = (cloth.membrane_gradient(x) + cloth.bending_gradient(x) - cloth.force())[cloth.held].sum(axis=0)
    assert carried[1] == pytest.approx(weight, rel=1e-3)


def test_a_drape_is_continued_where_it_hangs(solver: Solver, drapes: Drapes) -> None:
    first = drapes["stiff", Scene.HANGING]
    setup = Setup.nominal(Scene.HANGING)
    same = solver.solve(FABRICS["stiff"], setup, start=first)
    assert same.ok and same.iterations <= 3
    assert np.abs(same.vertices - first.vertices).max() < 1e-4
    moved = solver.solve(FABRICS["stiff"], setup.with_pins(top_right=(0.21, 0.01, 0.0)), start=first, jitter=NO_JITTER)
    assert moved.ok
    assert positions(moved)[0, -1] == pytest.approx([0.21, 0.01, 0.0])
    assert cloth_of(moved, FABRICS["stiff"], setup, jitter=NO_JITTER).residual(positions(moved)) < 1e-3


def test_a_drape_to_start_from_may_be_of_single_precision(solver: Solver, drapes: Drapes) -> None:
    first = drapes["stiff", Scene.HANGING]
    single = replace(first, vertices=np.asfortranarray(first.vertices, dtype=np.float32))
    again = solver.solve(FABRICS["stiff"], Setup.nominal(Scene.HANGING), start=single)
    assert again.ok and again.vertices.dtype == np.float64
    assert np.abs(again.vertices - first.vertices).max() < 1e-4


def test_out_of_time_is_said(solver: Solver) -> None:
    drape = solver.solve(FABRICS["soft"], Setup.nominal(Scene.HANGING), time_limit_s=0.0)
    assert drape.status is DrapeStatus.NOT_STILL
    assert "time" in drape.reason and "after 0 steps" in drape.reason
    assert not drape.ok and drape.iterations == 0


def test_a_limit_is_kept_while_the_sample_is_put_up(solver: Solver, monkeypatch: pytest.MonkeyPatch) -> None:
    looks = itertools.count()
    monkeypatch.setattr(time, "process_time", lambda: float(next(looks)))  # a second between two looks at the clock
    drape = solver.solve(FABRICS["soft"], Setup.nominal(Scene.HANGING), time_limit_s=20.0)
    assert drape.status is DrapeStatus.NOT_STILL and drape.reason.startswith("time limit; ")
    assert drape.iterations == 20 < STEPS, "steps of putting up, and none of Newton's method after them"


def test_other_samples_and_no_panel() -> None:
    small = Solver(GridMesh(0.02, (0.2, 0.4)))
    setup = Setup.nominal(Scene.HANGING, sample_size_m=(0.2, 0.4), panel=False, pin_radius_m=0.0)
    drape = small.solve(FABRICS["medium"], setup, seed=2)
    assert drape.ok
    assert drape.vertices.shape == (21 * 11, 3)
    assert cloth_of(drape, FABRICS["medium"], setup, seed=2).residual(positions(drape)) < 1e-3
