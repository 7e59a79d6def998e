"""The simulator with the found effects in it, as a file that other commands read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Final, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from diagnosis.effects import get_effect
from diagnosis.report import GapReport
from diagnosis.scene import SimulationScene
from renderer.atomic import write_atomically
from simcore.errors import InputError

FORMAT: Final = "drapemeter-simulator/1"
MOST_PIN_RADIUS_M = 0.1


class AppliedEffect(BaseModel):
    """An effect with all components of its size."""

    model_config = ConfigDict(frozen=True)

    name: str
    size: dict[str, float]

    @property
    def option(self) -> str:
        """As `drapemeter simulate --effect` takes it; without the seed of what is another one in every repeat."""
        shown = {k: v for k, v in self.size.items() if k != "seed" or not get_effect(self.name).random_repeats}
        return f"{self.name}=" + ",".join(f"{key}:{value:.6g}" for key, value in shown.items())


class SimulatorExtension(BaseModel):
    """What to add to the baseline simulation, and how its magnets hold the cloth.

    Attributes:
        effects: in the order in which they are applied.
        pin_radius_m: what a magnet holds round its corner, 0 for a point; None: as in the baseline.
    """

    model_config = ConfigDict(frozen=True)

    format: Literal["drapemeter-simulator/1"] = FORMAT
    effects: tuple[AppliedEffect, ...]
    pin_radius_m: float | None = Field(default=None, ge=0.0, le=MOST_PIN_RADIUS_M, allow_inf_nan=False)

    @classmethod
    def of(cls, report: GapReport, pin_radius_m: float | None = None) -> SimulatorExtension:
        """The effects that a report names; none where it names none.

        Args:
            report: of a diagnosis.
            pin_radius_m: of magnets, where they held the cloth otherwise than nominally.
        """
        found = []
        for effect in report.cause.effects:
            known = get_effect(effect.name)
            magnitude = effect.magnitude
            size = dict(magnitude) if isinstance(magnitude, dict) else {**known.size(magnitude), **effect.place}
            found.append(AppliedEffect(name=effect.name, size=known.size(size)))
        return cls(effects=tuple(found), pin_radius_m=pin_radius_m)

    @classmethod
    def load(cls, path: Path) -> SimulatorExtension:
        """Read a file that :meth:`save` wrote.

        Raises:
            InputError: it is missing, not of this format, or names an unknown effect or component.
        """
        try:
            found = cls.model_validate_json(path.read_text(encoding="utf-8"))
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror})", code="file_unreadable") from None
        except (ValidationError, UnicodeDecodeError):
            raise InputError(
                f"{path}: is no {FORMAT} document: make one with `drapemeter diagnose --apply`",
                code="extension_invalid",
            ) from None
        found.check()
        return found

    def check(self) -> None:
        """Whether it can be applied, as far as it tells itself.

        Raises:
            InputError: it names an unknown effect or component.
        """
        for effect in self.effects:
            get_effect(effect.name).size(effect.size)

    def save(self, path: Path) -> None:
        """Write it, whole or not at all."""
        write_atomically(path, (self.model_dump_json(indent=1) + "\n").encode())

    def seeded(self, draw: Callable[[str], float]) -> SimulatorExtension:
        """For one repeat: effects that differ from repeat to repeat get the seed that ``draw`` gives for their name."""
        effects = tuple(
            effect.model_copy(update={"size": {**effect.size, "seed": draw(effect.name)}})
            if get_effect(effect.name).random_repeats
            else effect
            for effect in self.effects
        )
        return self.model_copy(update={"effects": effects})

    def apply(self, scene: SimulationScene) -> SimulationScene:
        """A scene with the effects on, held as it says."""
        if self.pin_radius_m is not None:
            scene = scene.with_setup(replace(scene.setup, pin_radius_m=self.pin_radius_m))
        for effect in self.effects:
            scene = get_effect(effect.name).apply(scene, effect.size)
        return scene
