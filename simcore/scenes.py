"""The two scenes: where the magnets hold the sample, in the panel frame."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum

from simcore.errors import InputError
from simcore.number import are_finite, check_finite, shown

Vector3 = tuple[float, float, float]
GRAVITY_M_S2 = 9.81
STRETCH_PULL_M = 0.025 / math.sqrt(2.0)
"""Outward pull of the bottom right corner along x and along -y in ``stretch`` [m]."""


class Scene(StrEnum):
    """``hanging``: two top corners pinned. ``stretch``: also the bottom right corner, pulled outward."""

    HANGING = "hanging"
    STRETCH = "stretch"

    @classmethod
    def parse(cls, name: str) -> Scene:
        """Scene by name.

        Raises:
            InputError: unknown name.
        """
        try:
            return cls(name)
        except ValueError:
            raise InputError(
                f"unknown scene {name!r}: choose {' or '.join(s.value for s in cls)}", code="scene_unknown"
            ) from None


PIN_NAMES: dict[Scene, tuple[str, ...]] = {
    Scene.HANGING: ("top_left", "top_right"),
    Scene.STRETCH: ("top_left", "top_right", "bottom_right"),
}


@dataclass(frozen=True)
class Setup:
    """How a sample is put up; lengths [m], panel frame (x right, y up, z towards the camera).

    Attributes:
        scene: which scene; its name does, too.
        sample_size_m: width (weft, u) and height (warp, v) of the sample.
        pins_m: where each pinned corner sits, by name (``top_left``, ``top_right``, ``bottom_right``; in this order).
        pin_radius_m: all cloth within this distance of a pinned corner is held; 0 holds the corner point alone.
        panel: a panel stands at z = 0 behind the sample.

    Raises:
        InputError: an unknown scene, other pins than the scene has, or numbers that are none or out of range.
    """

    scene: Scene
    sample_size_m: tuple[float, float] = (0.5, 0.5)
    pins_m: dict[str, Vector3] = field(default_factory=dict)
    pin_radius_m: float = 0.01
    panel: bool = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "scene", Scene.parse(str(self.scene)))
        if not are_finite(self.sample_size_m, 2):
            raise InputError(
                f"the sample size, sample_size_m, needs a width and a height [m], got {shown(self.sample_size_m)}",
                code="sample_size",
            )
        width, height = self.sample_size_m
        if not (0.01 <= width <= 5.0 and 0.01 <= height <= 5.0):
            raise InputError(f"sample size {width} x {height} m is not between 0.01 and 5 m", code="sample_size")
        check_finite("the pin radius, pin_radius_m [m],", self.pin_radius_m, "pin_radius")
        if not 0.0 <= self.pin_radius_m < 0.25 * min(width, height):
            raise InputError(
                f"pin radius {self.pin_radius_m} m must be from 0 to a quarter of the sample", code="pin_radius"
            )
        names = set(PIN_NAMES[self.scene])
        pins: object = self.pins_m
        given = set(pins) if isinstance(pins, Mapping) else None
        if given != names:
            surplus = ", ".join(sorted(str(name) for name in (given or names) - names))
            raise InputError(
                f"scene {self.scene} needs pins {', '.join(PIN_NAMES[self.scene])}"
                + (f" and no {surplus}" if surplus else "")
                + (f": give a place by the name of each, not {shown(pins)}" if given is None else ""),
                code="pins_missing",
            )
        for name, place in self.pins_m.items():
            if not are_finite(place, 3):
                raise InputError(
                    f"pin {name} needs three finite coordinates [m], got {shown(place)}", code="pin_position"
                )
        ordered = {name: self.pins_m[name] for name in PIN_NAMES[self.scene]}
        object.__setattr__(self, "pins_m", ordered)

    @classmethod
    def nominal(
        cls,
        scene: Scene | str,
        *,
        sample_size_m: tuple[float, float] = (0.5, 0.5),
        pin_radius_m: float = 0.01,
        panel: bool = True,
    ) -> Setup:
        """The design's set-up, scaled in width and height for samples that are not 0.5 m square."""
        scene = Scene.parse(str(scene))
        width, height = sample_size_m
        if scene is Scene.HANGING:
            half = 0.40 * width
            pins: dict[str, Vector3] = {"top_left": (-half, 0.0, 0.0), "top_right": (half, 0.0, 0.0)}
        else:
            half = 0.49 * width
            pull_x, pull_y = STRETCH_PULL_M * width / 0.5, STRETCH_PULL_M * height / 0.5
            pins = {
                "top_left": (-half, 0.0, 0.0),
                "top_right": (half, 0.0, 0.0),
                "bottom_right": (0.5 * width + pull_x, -height - pull_y, 0.0),
            }
        return cls(scene, sample_size_m, pins, pin_radius_m, panel)

    def with_pins(self, **pins: Vector3) -> Setup:
        """The same with some pins elsewhere."""
        return replace(self, pins_m={**self.pins_m, **pins})
