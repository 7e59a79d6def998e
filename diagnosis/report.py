"""The gap report, format ``drape-gap-report/1``."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Final, Literal

from pydantic import BaseModel, ConfigDict, Field, SerializerFunctionWrapHandler, model_serializer

FORMAT: Final = "drape-gap-report/1"
Probability = Annotated[float, Field(ge=0.0, le=1.0)]
Region = Literal["pins", "top_edge", "sides", "hem", "interior", "panel", "all"]
Kind = Literal["pixels", "panel_plane", "low_order", "folds", "all"]
StageName = Literal["fabric", "setup", "environment", "camera", "sensor"]


class _Model(BaseModel):
    model_config = ConfigDict(extra="allow", frozen=True)

    may_lack: ClassVar[tuple[str, ...]] = ()
    """Fields that are not written where they were not given: the format does without them."""

    @model_serializer(mode="wrap")
    def _as_given(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        written: dict[str, Any] = write(self)
        lacking = set(self.may_lack) - self.model_fields_set
        return {key: value for key, value in written.items() if key not in lacking}


class Gap(_Model):
    """Whether captures and simulations differ by more than repeats do.

    Attributes:
        scene: of the captures that ``value`` and ``noise_floor`` are of.
        p_shape, p_pixels, p_factor: of the three tests (:func:`diagnosis.gap.detection.detect`).
    """

    may_lack = ("scene", "p_shape", "p_pixels", "p_factor")

    detected: bool
    p_value: Probability
    value: float
    noise_floor: float
    unit: str = "mm"
    scene: str | None = None
    p_shape: float | None = None
    p_pixels: float | None = None
    p_factor: float | None = None


class RegionGap(_Model):
    """One part of one scene's gap; :mod:`diagnosis.gap.where` says how its numbers are computed.

    Attributes:
        scene: of the captures.
        region: of the cloth; ``all`` in rows by kind or stage.
        stage: of a row by stage, that stage; else where what explains the row best sits: a named effect, or the
            leading effect of a stage.
        gap, noise_floor: in ``unit``.
        p_adjusted: for the number of rows of the report.
        by: what the row is one of.
        kind: spatial kind; ``all`` in rows by region or stage.
        unit: ``mm`` or ``standard deviations``.
        effect: what ``stage`` rests on; None where no effect that was tried explains anything of the row.
        explained: share of the row's squared difference that this effect takes away, at its fitted size.
    """

    scene: Literal["hanging", "stretch"]
    region: Region
    stage: StageName
    gap: float
    noise_floor: float
    p_adjusted: Probability
    by: Literal["region", "kind", "stage"] = "region"
    kind: Kind = "all"
    unit: str = "mm"
    effect: str | None = None
    explained: Probability = 0.0


class FoundEffect(_Model):
    """An effect that was named, with its size; ``place``: the components that say where or which way."""

    may_lack = ("place",)

    name: str
    stage: StageName
    magnitude: float | dict[str, float]
    unit: str
    interval_90: tuple[float, float] | dict[str, tuple[float, float]]
    place: dict[str, float] = {}


class CauseReport(_Model):
    """Which effect, or none, or something unknown.

    Attributes:
        both_probability: that two named effects are both there; a pair's share of ``probabilities`` is split by them.
        alike: of each named effect, what of ``not_separable_from`` it is not told from; all of it where that lacks.
    """

    may_lack = ("both_probability", "alike")

    probabilities: dict[str, Probability]
    top: str
    effects: tuple[FoundEffect, ...]
    not_separable_from: tuple[str, ...]
    both_probability: Probability | None = None
    alike: dict[str, tuple[str, ...]] = {}


class RegionShrinkage(_Model):
    """Before and after in one region of the cloth, in the shrinkage's unit; numbers as those of the whole.

    Reports of before version 20 have no ``fraction``, ``interval_90`` and ``repeats`` here.
    """

    region: Region
    before: float
    after: float
    noise_floor: float
    fraction: float | None = None
    interval_90: tuple[float, float] | None = None
    repeats: float | None = None


class Control(_Model):
    """What the most flexible effect that is not named would have gained, fold by fold."""

    effects: tuple[str, ...]
    after: float
    fraction: float


class Perceived(_Model):
    """The same as people see it: LPIPS drape distance between shaded pictures of captures and simulations.

    ``fraction`` of the distance above the floor that goes away, with its interval over what was held out; both and the
    floor are None where repeats give none.
    """

    before: float
    after: float
    noise_floor: float | None
    fraction: float | None = None
    interval_90: tuple[float, float] | None = None
    backend: str
    captures: int


class SeenRegion(_Model):
    """Depth in one region of the cloth, or on the panel round it [mm]; no floor and share where repeats give none."""

    region: Region
    before: float
    after: float
    noise_floor: float | None
    fraction: float | None = None
    interval_90: tuple[float, float] | None = None


class SeenDepth(_Model):
    """The same in millimetres of depth, pixel by pixel, where camera or sensor are what was found."""

    before: float
    after: float
    noise_floor: float | None
    fraction: float | None = None
    interval_90: tuple[float, float] | None = None
    captures: int
    regions: tuple[SeenRegion, ...] = ()


class RefittedParameters(_Model):
    """Ordinary parameters of a held-out fabric, refitted without and with the effect."""

    fabric: str
    before: dict[str, float]
    after: dict[str, float]


class Shrinkage(_Model):
    """How far the gap shrinks on held-out captures once the effect is added.

    ``fraction`` = (before - after) / (before - noise_floor). ``noise_floor`` is ``repeats``, the scatter of repeats, or
    what is left where that is less. ``named_without``: of every part that was held out in turn, what the others name.
    """

    held_out: tuple[str, ...]
    before: float
    after: float
    noise_floor: float
    fraction: float
    interval_90: tuple[float, float]
    unit: str = "mm"
    repeats: float | None = None
    simulated_afresh: bool = False
    control: Control | None = None
    regions: tuple[RegionShrinkage, ...] = ()
    parameters: tuple[RefittedParameters, ...] = ()
    perceived: Perceived | None = None
    depth: SeenDepth | None = None
    note: str | None = None
    named_without: tuple[tuple[str, ...], ...] = ()


class CostReport(_Model):
    """Simulations solved for this report and its wall-clock seconds.

    Attributes:
        solver_seconds: of the solver alone.
        cached: simulations that were at hand.
    """

    may_lack = ("solver_seconds", "cached")

    simulations: int
    seconds: float
    solver_seconds: float = 0.0
    cached: int = 0


class GapReport(_Model):
    """Everything the diagnosis says of a capture set; ``assumed``: what had to be, in words."""

    may_lack = ("assumed",)

    format: Literal["drape-gap-report/1"] = FORMAT
    gap: Gap
    where: tuple[RegionGap, ...]
    cause: CauseReport
    shrinkage: Shrinkage | None
    parameters_refitted: bool
    cost: CostReport
    model_version: str
    assumed: tuple[str, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """Plain JSON value."""
        return dict(self.model_dump(mode="json"))
