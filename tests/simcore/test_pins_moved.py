"""Pins that effects move, against closed forms and the work of their forces."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from diagnosis.effects import get_effect
from diagnosis.scene import SimulationScene
from simcore.drape import Drape
from simcore.mechanics import (
    NO_JITTER,
)
from simcore.scenes import Scene, Setup
from simcore.solver import Solver

from .judge import cloth_of, held_places, positions
from .rigs import FABRICS


def moved(effect: str, size: float, scene: Scene, sample_size_m: tuple[float, float] = (0.5, 0.5)) -> Setup:
    """The set-up with pins where the effect puts them; nothing else may change."""
    plain = SimulationScene(Setup.nominal(scene, sample_size_m=sample_size_m))
    changed = get_effect(effect).apply(plain, size)
    assert replace(changed, setup=plain.setup) == plain
    return changed.setup


@pytest.mark.parametrize("scene", Scene)
@pytest.mark.parametrize(("size", "lowered"), [(0.007, "top_right"), (-0.007, "top_left")])
def test_pin_drop_lowers_the_right_pin_and_the_left_one_if_negative(size: float, lowered: str, scene: Scene) -> None:
    nominal = Setup.nominal(scene)
    x, y, z = nominal.pins_m[lowered]
    assert moved("pin_drop", size, scene) == nominal.with_pins(**{lowered: (x, y - 0.007, z)})


def test_drops_of_either_sign_give_mirrored_drapes(solver: Solver) -> None:
    a, b = (
        solver.solve(FABRICS["vstiff"], moved("pin_drop", size, Scene.HANGING), jitter=NO_JITTER)
        for size in (0.012, -0.012)
    )
    assert a.ok and b.ok
    assert np.abs(positions(a) - positions(b)[:, ::-1] * [-1.0, 1.0, 1.0]).max() < 1e-4
    assert positions(a)[0, -1, 1] == pytest.approx(-0.012) and positions(a)[0, 0, 1] == 0.0
    assert positions(a)[-1, -1, 1] < positions(a)[-1, 0, 1] - 0.006  # the whole sheet hangs lower on that side


@pytest.mark.parametrize("sample", [(0.5, 0.5), (0.3, 0.3), (0.4, 0.5), (0.5, 0.2)])
@pytest.mark.parametrize("size", [0.009, -0.006])
def test_corner_pull_goes_on_along_the_scene_s_own_pull(size: float, sample: tuple[float, float]) -> None:
    nominal, (width, height) = Setup.nominal(Scene.STRETCH, sample_size_m=sample), sample
    own = np.subtract(nominal.pins_m["bottom_right"], (0.5 * width, -height, 0.0))  # from the flat sample's corner
    place = moved("corner_pull", size, Scene.STRETCH, sample).pins_m["bottom_right"]
    assert np.subtract(place, nominal.pins_m["bottom_right"]) == pytest.approx(size * own / np.linalg.norm(own))
    if width == height:
        x, y, z = nominal.pins_m["bottom_right"]
        assert place == (x + size / math.sqrt(2.0), y - size / math.sqrt(2.0), z)
    assert moved("corner_pull", size, Scene.STRETCH, sample) == nominal.with_pins(bottom_right=place)
    assert moved("corner_pull", size, Scene.HANGING, sample) == Setup.nominal(Scene.HANGING, sample_size_m=sample)


def test_the_farther_a_corner_is_pulled_the_more_energy_it_takes(solver: Solver) -> None:
    drapes = [
        solver.solve(FABRICS["vstiff"], moved("corner_pull", size, Scene.STRETCH), jitter=NO_JITTER)
        for size in (-0.01, 0.0, 0.01)
    ]
    assert all(d.ok for d in drapes)
    less, plain, more = (d.energy for d in drapes)
    assert less < plain < more


@pytest.mark.parametrize("effect", ["pin_drop", "pin_spacing", "corner_pull"])
def test_moving_pins_takes_the_work_of_the_forces_that_they_hold(effect: str, solver: Solver) -> None:
    """dE / d(size) is the force on what is held along the way that it is moved: what is free is at rest."""
    step, nominal = 2e-4, Setup.nominal(Scene.STRETCH)
    rest = solver.solve(FABRICS["vstiff"], nominal, jitter=NO_JITTER)
    cloth, x = cloth_of(rest, FABRICS["vstiff"], nominal, jitter=NO_JITTER), positions(rest)
    places = held_places(rest, nominal, NO_JITTER, 0)[1]
    way = held_places(rest, moved(effect, step, Scene.STRETCH), NO_JITTER, 0)[1] - places
    expected = (cloth.energy(x + 0.01 * way) - cloth.energy(x - 0.01 * way)) / (0.02 * step)
    ends = [
        solver.solve(FABRICS["vstiff"], moved(effect, size, Scene.STRETCH), jitter=NO_JITTER, start=rest).energy
        for size in (step, 0.0)  # a drop of the other sign is of the other pin
    ]
    assert abs(expected) > 0.1  # N
    assert (ends[0] - ends[1]) / step == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("scene", Scene)
@pytest.mark.parametrize("effect", ["pin_drop", "pin_spacing", "corner_pull"])
def test_pins_moved_by_nothing_are_the_plain_scene_bit_by_bit(
    effect: str, scene: Scene, solver: Solver, drapes: dict[tuple[str, Scene], Drape]
) -> None:
    assert moved(effect, -0.0, scene) == moved(effect, 0.0, scene) == Setup.nominal(scene)
    drape = solver.solve(FABRICS["vstiff"], moved(effect, 0.0, scene))
    assert np.array_equal(drape.vertices, drapes["vstiff", scene].vertices)
    assert drape.energy == drapes["vstiff", scene].energy
