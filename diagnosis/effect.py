"""What an effect is: a mechanism that the baseline lacks, with a size, and how it changes a simulation."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, fields
from enum import StrEnum
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from diagnosis.groups import NOT_EFFECTS
from diagnosis.scene import SimulationScene
from simcore.errors import DrapemeterError, InputError

SCALAR = "magnitude"
"""Name of the only component of an effect whose size is one number."""


class Stage(StrEnum):
    """Where in the way from fabric to picture an effect sits."""

    FABRIC = "fabric"
    SETUP = "setup"
    ENVIRONMENT = "environment"
    CAMERA = "camera"
    SENSOR = "sensor"


@dataclass(frozen=True)
class Component:
    """One number of an effect's size and what is believed of it beforehand.

    Attributes:
        low, high: range of its absolute value, in the effect's unit.
        signed: both signs occur.
        most: the largest absolute value that there can be, as 1 of a share; fitted sizes may otherwise lie above
            ``high``.
    """

    low: float
    high: float
    signed: bool = False
    most: float = math.inf

    def __post_init__(self) -> None:
        if not 0.0 < self.low < self.high or not math.isfinite(self.high):
            raise InputError(
                f"a size from {self.low:g} to {self.high:g}: give two positive numbers, the smaller one first",
                code="effect_file",
            )
        if not self.most >= self.high:
            raise InputError(
                f"most={self.most:g} is below the largest usual size, {self.high:g}: give the same or more",
                code="effect_file",
            )

    def draw(self, rng: np.random.Generator) -> float:
        """A size from the prior: log-uniform in the absolute value."""
        size = math.exp(rng.uniform(math.log(self.low), math.log(self.high)))
        return -size if self.signed and rng.random() < 0.5 else size


MAY_CHANGE: Mapping[Stage, tuple[str, ...]] = MappingProxyType(
    {
        Stage.FABRIC: ("mechanics",),
        Stage.SETUP: ("setup", "mechanics"),
        Stage.ENVIRONMENT: ("mechanics",),
        Stage.CAMERA: ("camera", "pose"),
        Stage.SENSOR: ("sensor",),
    }
)
"""What of a scene an effect of a stage changes: what else it changed would be passed over by the diagnosis."""

Size = Mapping[str, float]
"""Component name to value; ``{"magnitude": x}`` for an effect of one number."""

Apply = Callable[[SimulationScene, Size], SimulationScene]


@dataclass(frozen=True)
class Twin:
    """An effect that does the same to a fabric at another size.

    Attributes:
        name: of that effect.
        size: its magnitudes that do the same as given ones of this effect, to a fabric of some density [kg/m2].
    """

    name: str
    size: Callable[[NDArray[np.float64], float], NDArray[np.float64]]


@dataclass(frozen=True)
class Between:
    """A place that is not simulated beforehand: what an effect does there is about what it does at others, mixed.

    Attributes:
        place: its components.
        shares: number of each of those others among the effect's ``places`` to its share; they sum to one.
    """

    place: Mapping[str, float]
    shares: Mapping[int, float]


@dataclass(frozen=True)
class Effect:
    """One entry of the catalogue.

    Attributes:
        name: as in reports and on the command line.
        stage: where it sits.
        unit: of its size.
        components: prior of each number of its size.
        summary: what it does, one sentence.
        hook: what it sets in the simulation.
        source: where the mechanism or its numbers come from.
        change: the change itself; use :meth:`apply`.
        vector: the components are those of a vector: a size below ``low`` in one of them is no contradiction, the
            whole vector's length is in the range.
        random_repeats: the effect differs from repeat to repeat (scatter, not a shift); its places have a ``seed``.
        places: further components, set together: where or which way; simulated one after the other. The first one is
            the default.
        odds: how probable the places are, relative to each other; nothing: all alike.
        between: further places, each as probable as one of odds 1.
        alike: correlation of what is learnt of it at one place with what holds at another; 0: each is by itself.
        anywhere: draws a place where the effect may really be, which the listed ones stand for; None: those alone.
        where: what the places' components say, in words, for the page of the catalogue.
        holds: the cloth rests wherever it was put and any capture fits; not looked at again, and no half of a pair.
        white: it changes pixels one by one, as chance has it: their mean over a cell changes otherwise in each picture,
            and nothing is said of it.
        vague: pixel statistics that it changes by more or less, as chance has it.
        twin: an effect that differs from it only in how its sizes go with the fabrics' density.
        vanishes_at_zero: a size of zero is no effect; otherwise the effect vanishes as the size grows.
        fine: coarse cells do not hold what it does (strains, a narrow strip), so it is simulated on fine ones.
        presses: sign of the sizes at which it presses the cloth to the panel everywhere; 0: at none.
        share: its size, of unit 1, is a share of something and is told in per cent.
    """

    name: str
    stage: Stage
    unit: str
    components: Mapping[str, Component]
    summary: str
    hook: str
    source: str
    change: Apply = field(repr=False)
    vector: bool = False
    random_repeats: bool = False
    holds: bool = False
    white: bool = False
    vague: tuple[str, ...] = ()
    twin: Twin | None = None
    vanishes_at_zero: bool = True
    fine: bool = False
    presses: int = 0
    share: bool = False
    places: tuple[Mapping[str, float], ...] = (MappingProxyType({}),)
    odds: tuple[float, ...] = ()
    between: tuple[Between, ...] = ()
    alike: float = 0.0
    anywhere: Callable[[np.random.Generator], Mapping[str, float]] | None = field(default=None, repr=False)
    where: str = ""

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[a-z][a-z0-9_]*", self.name) or self.name in NOT_EFFECTS:
            raise InputError(
                f"{self.name!r} cannot be an effect's name: use small letters, digits and _, and none of "
                f"{', '.join(NOT_EFFECTS)}",
                code="effect_file",
            )
        for wrong in self._faults():
            raise InputError(f"effect {self.name}: {wrong}", code="effect_file")

    def _faults(self) -> Iterator[str]:
        """What cannot be, and how to mend it."""
        stage: object = self.stage  # a user's file may give anything
        if not isinstance(stage, Stage):
            yield f"stage={stage!r}: give one of {', '.join(f'Stage.{known.name}' for known in Stage)}"
        if not self.components:
            yield "it has no components: give scalar(...) or vector(...)"
        components: Mapping[str, object] = self.components
        if not all(isinstance(component, Component) for component in components.values()):
            yield "components: give scalar(...) or vector(...), which make them"
            return
        if not self.vanishes_at_zero and any(component.signed for component in self.components.values()):
            yield "vanishes_at_zero=False: the larger, the weaker, which goes with sizes of one sign alone"
        if self.vector and self.random_repeats:
            yield "random_repeats: give a size of one number, not a vector"
        if not self.vector and list(self.components) != [SCALAR]:
            yield (
                f"components {', '.join(self.components)}: give one number named {SCALAR} (scalar(...), its places "
                "apart), or a vector (vector(...) with vector=True)"
            )
        if self.presses not in (-1, 0, 1) or (self.presses and list(self.components) != [SCALAR]):
            yield f"presses={self.presses!r}: give 1 or -1 to an effect whose size is one number, 0 to any other"
        if self.share and self.unit != "1":
            yield f"share=True goes with unit 1, not {self.unit!r}"
        places: object = self.places
        if not isinstance(places, tuple) or not all(isinstance(place, Mapping) for place in places):
            yield "places: give a tuple of mappings from name to number, such as ({'width_m': 0.02}, {'width_m': 0.04})"
            return
        numbers: list[object] = [value for place in self.places for value in place.values()]
        if not all(isinstance(value, int | float) and math.isfinite(value) for value in numbers):
            yield "places: give each of their names a finite number"
            return
        if self.vector and any(self.places):
            yield "a vector has no places: give it none, or one number in place of the vector"
        if not self.places or any(set(place) != set(self.places[0]) for place in self.places):
            yield "places: give at least one, all with the same names"
        if any(set(place) & set(self.components) for place in self.places):
            yield f"places: give their numbers other names than {', '.join(self.components)}"
        if self.random_repeats and self.places and "seed" not in self.places[0]:
            yield "random_repeats: give it places with a seed to draw from, such as ({'seed': 1.0}, {'seed': 2.0})"
        if self.odds and not (len(self.odds) == len(self.places) and all(0.0 < o < math.inf for o in self.odds)):
            yield f"odds: give {len(self.places)} positive numbers, one to each place"
        if not 0.0 <= self.alike < 1.0:
            yield f"alike={self.alike!r}: give 0 or more, less than 1"
        yield from self._faults_between()

    def _faults_between(self) -> Iterator[str]:
        numbers = range(len(self.places))
        for own in self.between:
            if set(own.place) != set(self.places[0]):
                yield "between: give places of the same names as the others"
            elif not set(own.shares) <= set(numbers) or not math.isclose(sum(own.shares.values()), 1.0):
                yield f"between: give shares that sum to one, of places 0 to {len(self.places) - 1}"
            elif own.place in self.places:
                yield "between: a place that is simulated needs no mixture of others"

    @property
    def place_shares(self) -> NDArray[np.float64]:
        """How probable each place that is simulated is, [places]."""
        odds = np.array(self.odds or (1.0,) * len(self.places))
        return np.asarray(odds / odds.sum())

    @property
    def tried(self) -> tuple[Mapping[str, float], ...]:
        """All places at which the effect may be found: those that are simulated, then those between them."""
        return (*self.places, *(own.place for own in self.between))

    @property
    def tried_shares(self) -> NDArray[np.float64]:
        """How probable each of them is, [tried]."""
        odds = np.array([*(self.odds or (1.0,) * len(self.places)), *(1.0 for _ in self.between)])
        return np.asarray(odds / odds.sum())

    def number_of(self, size: Size) -> int:
        """Which of :attr:`tried` a size is at; one that says nothing of its place is at the first.

        Raises:
            InputError: at none of them.
        """
        whole = size if self.places[0].keys() <= size.keys() else self.size(size)
        own = {key: whole[key] for key in self.places[0]}
        for number, place in enumerate(self.tried):
            if all(own[key] == at for key, at in place.items()):
                return number
        where = ", ".join(f"{key} {at:g}" for key, at in own.items())
        raise InputError(
            f"{self.name} is not looked for at {where}: give one of the {len(self.tried)} places where it is tried",
            code="effect_place",
        )

    @property
    def moves_cloth(self) -> bool:
        """It changes how the cloth comes to rest, the same way in all repeats."""
        return self.stage in (Stage.FABRIC, Stage.SETUP, Stage.ENVIRONMENT) and not self.random_repeats

    def apply(self, scene: SimulationScene, magnitude: float | Size) -> SimulationScene:
        """The scene with the effect on.

        Args:
            scene: without it.
            magnitude: a number in the effect's unit, or its components by name (missing ones: zero for a vector, the
                middle of their range otherwise).

        Raises:
            InputError: not finite, a component that the effect does not have, or a file's change that cannot be.
        """
        size = self.size(magnitude)
        pins = dict(scene.setup.pins_m)
        try:
            changed: object = self.change(scene, size)
        except DrapemeterError as error:
            if re.search(rf"\b{self.name}\b", str(error)):
                raise
            shown = ", ".join(f"{name} {value:g}" for name, value in size.items())
            raise type(error)(f"effect {self.name} of {shown}: {error}", code=error.code) from error
        except Exception as error:  # whatever a user's own file does
            said = " ".join(str(error).split()) or "no reason given"
            raise InputError(
                f"effect {self.name}: its change of a {scene.setup.scene.value} scene fails: {type(error).__name__}: "
                f"{said}",
                code="effect_file",
            ) from error
        if scene.setup.pins_m != pins:
            scene.setup.pins_m.clear()
            scene.setup.pins_m.update(pins)
            raise InputError(
                f"effect {self.name}: its change moves the pins of the very scene that it is given: leave that as it "
                "is and return scene.with_setup(...)",
                code="effect_file",
            )
        if not isinstance(changed, SimulationScene):
            raise InputError(
                f"effect {self.name}: its change gives {type(changed).__name__}, not a scene: return the changed scene",
                code="effect_file",
            )
        other = [f.name for f in fields(scene) if getattr(changed, f.name) != getattr(scene, f.name)]
        if not set(other) <= set(MAY_CHANGE[self.stage]):
            raise InputError(
                f"effect {self.name}: its change sets {', '.join(other)}, an effect of the {self.stage.value} stage "
                f"{' and '.join(MAY_CHANGE[self.stage])} alone: give it the stage of what it changes",
                code="effect_file",
            )
        return changed

    def size(self, magnitude: float | Size) -> dict[str, float]:
        """All components of a magnitude, checked. One number given to a vector sets its first component.

        A place of which only a part is given is the first one with that part, and else the first one but for that.
        """
        given = dict(magnitude) if isinstance(magnitude, Mapping) else {next(iter(self.components)): magnitude}
        known = [*self.components, *self.places[0]]
        unknown = set(given) - set(known)
        if unknown:
            raise InputError(
                f"{self.name} has no component {', '.join(sorted(unknown))}: choose from {', '.join(known)}",
                code="effect_component_unknown",
            )
        if not all(math.isfinite(value) for value in given.values()):
            raise InputError(f"{self.name}: a magnitude must be a finite number [{self.unit}]", code="effect_magnitude")
        size = {name: float(given.get(name, self._default(name))) for name in self.components}
        part = {name: float(given[name]) for name in self.places[0] if name in given}
        like = (place for place in self.tried if part.items() <= place.items())
        return size | {name: float(value) for name, value in next(like, self.places[0]).items()} | part

    def draw(self, rng: np.random.Generator, *, listed: bool = False) -> dict[str, float]:
        """A size from the prior; a vector's direction is uniform, its length log-uniform.

        Args:
            rng: random numbers.
            listed: at one of the places that are simulated, also where the effect may be elsewhere.
        """
        if not self.vector:
            if self.anywhere is None or listed:
                place = self.places[int(rng.choice(len(self.places), p=self.place_shares))]
            else:
                place = self.anywhere(rng)
            return {name: component.draw(rng) for name, component in self.components.items()} | dict(place)
        first = next(iter(self.components.values()))
        length = math.exp(rng.uniform(math.log(first.low), math.log(first.high)))
        direction = rng.standard_normal(len(self.components))
        direction *= length / np.linalg.norm(direction)
        return dict(zip(self.components, direction.tolist(), strict=True))

    def typical(self) -> dict[str, float]:
        """A size from the middle of the prior, for pictures."""
        if self.vector:
            first = next(iter(self.components.values()))
            share = math.sqrt(first.low * first.high / len(self.components))
            return dict.fromkeys(self.components, share)
        return {name: math.sqrt(c.low * c.high) for name, c in self.components.items()} | dict(self.places[0])

    def _default(self, name: str) -> float:
        component = self.components[name]
        return 0.0 if self.vector else math.sqrt(component.low * component.high)


def not_negative(name: str, value: float) -> float:
    """A size that has no other sign.

    Raises:
        InputError: it is negative.
    """
    if value < 0.0:
        raise InputError(f"{name} {value:g} is negative: give 0 or more", code="effect_magnitude")
    return value


def scalar(low: float, high: float, *, signed: bool = False, most: float = math.inf) -> Mapping[str, Component]:
    """Components of an effect whose size is one number, in absolute value ``most`` at most."""
    return MappingProxyType({SCALAR: Component(low, high, signed, most=most)})


def vector(names: tuple[str, ...], low: float, high: float) -> Mapping[str, Component]:
    """Components of an effect whose size is a vector with a length in a range."""
    return MappingProxyType({name: Component(low, high, True) for name in names})
