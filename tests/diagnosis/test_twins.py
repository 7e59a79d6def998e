"""A draft and a tilt do the same to one fabric; how their sizes go with the density tells them apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.effect import SCALAR
from diagnosis.effects import catalogue, get_effect
from diagnosis.effects.air_draft import as_tilt
from diagnosis.effects.panel_tilt import as_draft
from diagnosis.inference.block import Block, PixelBlock, View
from diagnosis.inference.cause import Cause, name_cause
from diagnosis.scene import SimulationScene
from diagnosis.simulation.sizes import node_values, nodes
from simcore.scenes import Setup

COUNT = 60
DENSITIES = (0.1, 0.18, 0.25, 0.4)
EFFECTS = ("air_draft", "panel_tilt")


def test_sizes_of_twins_answer_each_other() -> None:
    for name, effect in catalogue().items():
        if effect.twin is not None:
            back = get_effect(effect.twin.name).twin
            assert back is not None and back.name == name
            sizes = np.array([-effect.components[SCALAR].low, effect.components[SCALAR].low])
            np.testing.assert_allclose(back.size(effect.twin.size(sizes, 0.25), 0.25), sizes)


@pytest.mark.parametrize("tilt", [-8.0, 8.0])
def test_a_draft_presses_as_gravity_does_across_a_tilted_panel(tilt: float) -> None:
    density, upright = 0.2, SimulationScene(Setup.nominal("stretch"))
    across = get_effect("panel_tilt").apply(upright, tilt).mechanics.gravity[2] * density
    pressed = get_effect("air_draft").apply(upright, float(as_draft(np.array([tilt]), density)[0]))
    pressure = pressed.mechanics.air_pressure_pa
    assert pressure == pytest.approx(across)
    assert float(as_tilt(np.array([pressure]), density)[0]) == pytest.approx(tilt)


def fabrics(pressures: list[float], simulated: str) -> list[Block]:
    """Fabrics under given pressures [Pa]; only one of the twins was simulated in the folds that are seen."""
    rng = np.random.default_rng(8)
    blocks = []
    owner, cell, still = np.repeat([0, 1], COUNT // 2), np.tile(np.arange(COUNT // 2), 2), np.zeros((4, COUNT))
    for number, (density, pressure) in enumerate(zip(DENSITIES, pressures, strict=True)):
        form = 25.0 * rng.standard_normal(COUNT)
        draft = np.array([[size[SCALAR]] for size in nodes(get_effect("air_draft"))]) * form
        tilt = as_draft(np.array(node_values(get_effect("panel_tilt"))), density)[:, None] * form
        rows = {"air_draft": draft, "panel_tilt": tilt}
        other = EFFECTS[1 - EFFECTS.index(simulated)]
        rows[other] = 8.0 * rng.standard_normal(rows[other].shape)
        measured = pressure * form + rng.standard_normal(COUNT)
        view = View(measured, rows, {}, np.eye(COUNT), 0.0)
        own = Block(f"f{number}", "stretch", ("a", "b"), view, view, cell, owner, np.zeros((7, COUNT)), still, still)
        blocks.append(replace(own, density=density))
    return blocks


def named(blocks: list[Block]) -> Cause:
    still = {name: np.zeros((len(nodes(get_effect(name))), 1)) for name in EFFECTS}
    return name_cause(EFFECTS, blocks, PixelBlock(np.zeros(1), still, sensor_known=False))


@pytest.mark.parametrize("simulated", EFFECTS)
@pytest.mark.parametrize("true", EFFECTS)
def test_which_twin_it_is_does_not_hang_on_which_was_simulated_in_the_right_folds(true: str, simulated: str) -> None:
    tilted = [float(as_draft(np.array([9.0]), density)[0]) for density in DENSITIES]
    cause = named(fabrics(tilted if true == "panel_tilt" else [-0.3] * 4, simulated))
    assert cause.named == (true,)
    expected = 9.0 if true == "panel_tilt" else -0.3
    assert cause.size(true)[SCALAR] == pytest.approx(expected, rel=0.15)


def test_without_a_density_an_effect_is_judged_by_its_own_simulations() -> None:
    tilted = [float(as_draft(np.array([9.0]), density)[0]) for density in DENSITIES]
    blocks = [replace(block, density=float("nan")) for block in fabrics(tilted, "air_draft")]
    assert "panel_tilt" not in named(blocks).named
