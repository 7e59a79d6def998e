"""What a simulator file takes over from a diagnosis, and what is told of it."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from diagnosis.extension import AppliedEffect, SimulatorExtension
from diagnosis.scene import SimulationScene, pose_rows
from services.cli.diagnose_apply import doubts, held_m
from simcore.scenes import Setup

PLAIN = SimulationScene(Setup.nominal("stretch"))
P = {"air_draft": 0.43, "hem_weight": 0.9, "depth_bias": 0.95, "sensor_smoothing": 0.9, "range_noise": 0.9}


def found(*scenes: SimulationScene, named: tuple[str, ...] = ("hem_weight",), both: float = 0.0) -> Any:
    captures = [SimpleNamespace(scene=scene) for scene in scenes or (PLAIN,)]
    cause = SimpleNamespace(probabilities=P, named=named, both_probability=both)
    return SimpleNamespace(cause=cause, results=[SimpleNamespace(task=SimpleNamespace(captures=captures))])


def made(**effects: float) -> SimulatorExtension:
    return SimulatorExtension(
        effects=tuple(AppliedEffect(name=name, size={"magnitude": size}) for name, size in effects.items())
    )


def held(radius_m: float) -> SimulationScene:
    return PLAIN.with_setup(replace(PLAIN.setup, pin_radius_m=radius_m))


@pytest.mark.parametrize(
    ("effects", "words"),
    [
        ({}, ["nothing is named"]),
        ({"air_draft": 0.3}, ["probability 0.43 only"]),
        ({"hem_weight": 20.0}, []),
        ({"depth_bias": 0.008}, ["moves the panel"]),
    ],
)
def test_what_to_know_of_a_simulator_file_is_told(effects: dict[str, float], words: list[str]) -> None:
    told = list(doubts(made(**effects), found()))
    assert len(told) == len(words) and all(word in line for word, line in zip(words, told, strict=True))


def test_of_two_effects_the_probability_is_that_of_both() -> None:
    two = found(named=("hem_weight", "air_draft"), both=0.39)
    assert ["probability 0.39 only" in line for line in doubts(made(hem_weight=20.0, air_draft=0.3), two)] == [True]


def test_the_radius_is_the_one_that_was_simulated() -> None:
    """On cells of 10 mm a magnet of 8 mm holds a whole cell, as it does nominally; on a point it does not."""
    assert held_m(found(held(0.01 * (1.0 + 1e-6)))) is None
    both = found(held(0.01), held(0.01 * (1.0 + 1e-6)))
    assert held_m(both) is None and list(doubts(made(hem_weight=20.0), both)) == []
    assert held_m(found(held(0.0125), held(0.0126))) == 0.0125
    assert held_m(found(held(0.0))) == 0.0
    assert held_m(found(held(0.02), held(0.02))) == 0.02
    assert held_m(found(held(0.0), held(0.02))) is None
    assert any("magnets hold 0, 20 mm" in line for line in doubts(made(), found(held(0.0), held(0.02))))
    assert held_m(found(held(0.11))) is None and any("110 mm" in line for line in doubts(made(), found(held(0.11))))


def test_set_ups_that_simulated_pictures_do_not_have_are_told() -> None:
    bare = PLAIN.with_setup(replace(PLAIN.setup, panel=False))
    assert ["no panel behind" in line for line in doubts(made(hem_weight=20.0), found(bare))] == [True]
    wide = PLAIN.with_setup(PLAIN.setup.with_pins(top_left=(-0.26, 0.0, 0.0)))
    assert ["magnets sat elsewhere" in line for line in doubts(made(hem_weight=20.0), found(PLAIN, wide))] == [True]
    assert list(doubts(made(sensor_smoothing=2.0), found(bare, wide))) == []
    again = PLAIN.with_setup(PLAIN.setup.with_pins(top_left=(-0.246, 0.0, 0.0)))
    assert list(doubts(made(hem_weight=20.0), found(again))) == []


def test_sizes_of_another_rig_are_told() -> None:
    small = SimulationScene(Setup.nominal("stretch", sample_size_m=(0.25, 0.25)))
    assert any("samples of 250 x 250 mm" in line for line in doubts(made(hem_weight=20.0), found(small)))
    assert not any("samples of" in line for line in doubts(made(panel_tilt=8.0), found(small)))
    oblong = SimulationScene(Setup.nominal("stretch", sample_size_m=(0.3, 0.5)))
    assert any("samples of 300 x 500 mm" in line for line in doubts(made(hem_weight=20.0), found(oblong)))
    sharp = replace(PLAIN, camera=replace(PLAIN.camera, fx=480.0, fy=480.0))
    assert any("1.5 times" in line for line in doubts(made(sensor_smoothing=2.0), found(sharp)))
    pose = np.array(PLAIN.camera_from_panel)
    pose[2, 3] *= 1.5
    level = replace(sharp, pose=pose_rows(pose))  # as many pixels to a metre
    assert list(doubts(made(sensor_smoothing=2.0), found(level))) == []
    near = PLAIN.with_sensor(at_m=0.45)
    assert any("4 times as large" in line for line in doubts(made(range_noise=0.003), found(near)))
