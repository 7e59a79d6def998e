"""What a simulator file takes over from a diagnosis, and what it cannot."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from diagnosis.effect import Stage
from diagnosis.effects import get_effect
from diagnosis.extension import MOST_PIN_RADIUS_M
from diagnosis.groups import group_of
from diagnosis.scene import SimulationScene, put_up_alike
from simcore.scenes import Setup

if TYPE_CHECKING:
    from diagnosis.diagnose import Diagnosis
    from diagnosis.extension import SimulatorExtension

ALIKE = 0.01
"""Lengths and distances that differ by a smaller share are the same."""


def held_m(found: Diagnosis) -> float | None:
    """What magnets held in the simulations of a diagnosis [m]; None: as they do nominally, or nothing that one number
    says.
    """
    radii = _radii(found)
    nominal = Setup.nominal("hanging").pin_radius_m
    held = radii.pop() if len(radii) == 1 else nominal
    return None if held > MOST_PIN_RADIUS_M or math.isclose(held, nominal, rel_tol=ALIKE) else held


def doubts(made: SimulatorExtension, found: Diagnosis) -> Iterator[str]:
    """What whoever simulates with a simulator file should know of it."""
    from services.dataset.extension import moves_panel

    cause = found.cause
    names = {twin for effect in made.effects for twin in group_of(effect.name)}
    p = cause.both_probability if len(cause.named) == 2 else sum(cause.probabilities.get(name, 0.0) for name in names)
    if not made.effects:
        yield "nothing is named, so it adds no effect to the simulation"
    elif p < 0.5:
        yield f"what it adds, or what captures cannot tell from it, has probability {p:.2f} only"
    radii = _radii(found)
    if len(radii) > 1 or max(radii) > MOST_PIN_RADIUS_M:
        yield f"magnets hold {_listed(radii)} mm round a corner in the captures, which it does not say"
    for effect in made.effects:
        if moves_panel(effect):
            yield f"{effect.name} moves the panel in pictures, so that `drapemeter dataset` will refuse it"
    yield from _of_another_rig(made, _scenes(found))


def _of_another_rig(made: SimulatorExtension, scenes: list[SimulationScene]) -> Iterator[str]:
    """Sizes that go with the captures' sample, camera or sensor and are applied to the nominal ones as they are."""
    nominal = SimulationScene(Setup.nominal("hanging"))
    sizes = {scene.setup.sample_size_m for scene in scenes}
    usual = nominal.setup.sample_size_m
    on_cloth = [e.name for e in made.effects if _goes_with_the_sample(e.name)]
    if on_cloth and any(abs(a / b - 1.0) > ALIKE for size in sizes for a, b in zip(size, usual, strict=True)):
        found = ", ".join(f"{1e3 * a:.4g} x {1e3 * b:.4g}" for a, b in sorted(sizes))
        yield (
            f"the size of {' and '.join(on_cloth)} was found on samples of {found} mm and is applied as it is "
            f"to samples of {1e3 * usual[0]:g} x {1e3 * usual[1]:g} mm"
        )
    if on_cloth and any(not scene.setup.panel for scene in scenes):
        yield "there was no panel behind captures, and there is one in simulated pictures"
    if on_cloth and any(not put_up_alike(_nominal_as(scene), scene.setup) for scene in scenes):
        yield "magnets sat elsewhere in captures than in simulated pictures, which the size of an effect may go with"
    names = {effect.name for effect in made.effects}
    sharp = {_pixels_a_metre(scene) / _pixels_a_metre(nominal) for scene in scenes}
    if "sensor_smoothing" in names and any(abs(share - 1.0) > ALIKE for share in sharp):
        yield (
            f"sensor_smoothing is in pixels of the captures' camera, which shows {_between(sharp)} times as many to a "
            "metre as that of simulated pictures"
        )
    stated = {scene.sensor.range_noise_m for scene in scenes}
    if "range_noise" in names and max(stated) > 0.0:
        yield (
            f"range_noise comes on top of the {_listed(stated)} mm that the captures' sensor has at the panel by what "
            "is stated, which simulated pictures lack"
        )
    noise = {(nominal.sensor.at_m / scene.sensor.at_m) ** 2 for scene in scenes}
    if "range_noise" in names and any(abs(share - 1.0) > ALIKE for share in noise):
        yield (
            f"range_noise is at the panel's distance in the captures; at the {nominal.sensor.at_m:g} m of an ideal "
            f"sensor it would be {_between(noise)} times as large"
        )


def _nominal_as(scene: SimulationScene) -> Setup:
    """The nominal set-up of a capture's scene, its sample's size and panel, and what its magnets hold."""
    stated = scene.setup
    return Setup.nominal(
        stated.scene, sample_size_m=stated.sample_size_m, pin_radius_m=stated.pin_radius_m, panel=stated.panel
    )


def _goes_with_the_sample(name: str) -> bool:
    """Its size says something of the sample or its magnets; a tilt is of the panel."""
    return get_effect(name).stage in (Stage.FABRIC, Stage.SETUP) and name != "panel_tilt"


def _pixels_a_metre(scene: SimulationScene) -> float:
    return scene.camera.fx / float(scene.camera_from_panel[2, 3])


def _scenes(found: Diagnosis) -> list[SimulationScene]:
    return [capture.scene for result in found.results for capture in result.task.captures]


def _radii(found: Diagnosis) -> set[float]:
    """Those that differ; magnets on cells that are a little larger hold as many of them."""
    apart: list[float] = []
    for radius in sorted({scene.setup.pin_radius_m for scene in _scenes(found)}):
        if not apart or not math.isclose(radius, apart[-1], rel_tol=ALIKE):
            apart.append(radius)
    return set(apart)


def _listed(lengths_m: set[float]) -> str:
    return ", ".join(f"{1e3 * length:.3g}" for length in sorted(lengths_m))


def _between(shares: set[float]) -> str:
    low, high = min(shares), max(shares)
    return f"{low:.2g}" if math.isclose(low, high, rel_tol=ALIKE) else f"{low:.2g} to {high:.2g}"
