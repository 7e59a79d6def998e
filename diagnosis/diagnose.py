"""Capture set in, gap report out."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

from capture.capture_set import CaptureSet
from diagnosis.afresh.alike import look_alike
from diagnosis.afresh.beside import look_beside
from diagnosis.afresh.between import look_between
from diagnosis.afresh.found_pose import with_poses_found
from diagnosis.afresh.fresh import FreshLook, Sized
from diagnosis.afresh.further import look_further
from diagnosis.afresh.grip import Grip, judge_grip, with_other_grip
from diagnosis.afresh.moved_pin import outdone_by_a_pin
from diagnosis.afresh.once import Name, once
from diagnosis.afresh.probing import look_probed
from diagnosis.afresh.refinement import look_again
from diagnosis.afresh.second import look_for_second
from diagnosis.afresh.through import look_through
from diagnosis.afresh.together import look_together
from diagnosis.anew import NO_MORE, Anew, estimated_anew, says_more
from diagnosis.atlas import forecast
from diagnosis.cause_report import cause_report
from diagnosis.effects import catalogue, get_effect
from diagnosis.extension import SimulatorExtension
from diagnosis.gap.detection import detect
from diagnosis.gap.where import where_gaps
from diagnosis.gathering import all_alike, cost_of, half_estimated, make_blocks, make_pixels, said_of_states
from diagnosis.inference.block import Block, PixelBlock
from diagnosis.inference.cause import Cause, name_cause
from diagnosis.inference.granted import likeliest
from diagnosis.inference.likelihood import LikelihoodModel
from diagnosis.inference.noise import NoiseModel
from diagnosis.inference.repeats import pin_scatter
from diagnosis.inference.subtract import pixels_without, without
from diagnosis.report import CostReport, GapReport
from diagnosis.shrinkage.held_out import Held, Judge, Measured, measure_shrinkage, not_at_rest_with
from diagnosis.shrinkage.in_report import complete
from diagnosis.shrinkage.refutation import judged
from diagnosis.shrinkage.splits import folds_of
from diagnosis.simulation.drape_cache import DrapeCache
from diagnosis.simulation.simulator import Cost, Simulator
from diagnosis.steps import LOOKS, UNTOLD, Steps, Told
from diagnosis.tasks.fabric_task import FabricResult, explain_fabric
from diagnosis.tasks.preparation import prepare_tasks
from diagnosis.version import MODEL_VERSION
from diagnosis.workers import ALONE, Workers
from simcore.errors import InputError

ROUGH = 0.05
"""Probability that a response on the coarse mesh is of other folds than those the effect gives, in ``stretch``."""


@dataclass(frozen=True)
class DiagnosisOptions:
    """How to diagnose.

    Attributes:
        effects: names to try; empty: the whole catalogue.
        without: names left out.
        resolution_m: of the meshes.
        workers: processes.
        afresh: simulate what may be named at its fitted size and judge again.
        lpips: measure the shrinkage as people see it, too.
    """

    effects: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    resolution_m: float = 0.01
    workers: int = 1
    afresh: bool = True
    lpips: bool = False

    def chosen(self) -> tuple[str, ...]:
        """The effects to try.

        Raises:
            InputError: an unknown name, or none left.
        """
        names = tuple(dict.fromkeys(self.effects)) or tuple(catalogue())
        for name in (*names, *self.without):
            get_effect(name)
        left = tuple(name for name in names if name not in self.without)
        if not left:
            raise InputError("no effect is left to try: leave some in the catalogue", code="no_effects")
        return left


@dataclass(frozen=True)
class Diagnosis:
    """A report with what it rests on, for pictures and further analysis.

    Attributes:
        pin_radius_m: of magnets that turned out to hold otherwise than stated; None where they hold as stated.
        spent: on simulations with magnets that turned out to hold otherwise, and with other estimates.
        given: in words, what had to be assumed before fabrics were simulated, and how their magnets hold.
    """

    report: GapReport
    results: tuple[FabricResult, ...]
    blocks: tuple[Block, ...]
    cause: Cause
    pixels: PixelBlock
    assumed: tuple[str, ...]
    held: tuple[Held, ...] = ()
    looks: Mapping[str, FreshLook] = field(default_factory=dict)
    pin_radius_m: float | None = None
    spent: Cost = field(default_factory=Cost)
    given: tuple[str, ...] = ()

    def having_spent(self, more: Cost, began: float, said: tuple[str, ...]) -> Diagnosis:
        """With what was simulated beside it since the work ``began`` (monotonic), and what is to be said of that."""
        spent = Cost()
        for one in (self.spent, more):
            spent.add(one)
        found = replace(self, spent=spent, assumed=(*self.assumed, *said)).recounted()
        cost = found.report.cost.model_copy(update={"seconds": round(time.monotonic() - began, 2)})
        return replace(found, report=found.report.model_copy(update={"cost": cost, "assumed": found.assumed}))

    def cost_in_all(self) -> Cost:
        """Of all simulations that it rests on or that led to it."""
        return cost_of(self.results, self.looks, self.spent)

    def recounted(self) -> Diagnosis:
        """With what was simulated since the report was made, for its pictures, in its cost."""
        cost = self.cost_in_all()
        told = self.report.cost.model_copy(
            update={
                "simulations": cost.simulations,
                "solver_seconds": round(cost.seconds, 2),
                "cached": cost.cached,
            }
        )
        return replace(self, report=self.report.model_copy(update={"cost": told}))


Look = Callable[[dict[str, FreshLook]], dict[str, FreshLook]]
"""Simulates more of what fabrics may show."""


def diagnose(
    captures: CaptureSet,
    options: DiagnosisOptions = DiagnosisOptions(),
    *,
    cache: DrapeCache | None = None,
    on_step: Told | None = None,
    on_forecast: Callable[[str], None] | None = None,
) -> Diagnosis:
    """Find the gap between captures and simulations and name its cause.

    Args:
        captures: the set.
        options: effects, mesh, workers.
        cache: of simulated drapes; the user's by default.
        on_step: told how far it is and what comes now, see :mod:`diagnosis.steps`.
        on_forecast: told beforehand what it will cost.

    Raises:
        InputError: captures that cannot be used.
        SimulationError: a fabric cannot be simulated at all; what did not come to rest is told in ``assumed``.
    """
    began = time.monotonic()
    effects = options.chosen()
    tasks, assumed = prepare_tasks(captures, effects, options.resolution_m)
    kept = cache or DrapeCache.default()
    if on_forecast is not None:
        on_forecast(forecast(tasks, kept).sentence())
    steps = Steps(on_step, len(tasks), rounds=1 + any(task.estimated for task in tasks))
    steps.begin()
    with Workers(min(options.workers, len(tasks))) as workers:
        results = workers.map(partial(explain_fabric, cache=kept), tasks, steps.fabric)
        found = with_poses_found(results)
        if found is not None:
            before, results = results, workers.map(partial(explain_fabric, cache=kept), found)
            for result, first in zip(results, before, strict=True):
                result.cost.add(first.cost)
        answer = partial(
            conclude,
            effects=effects,
            began=began,
            cache=kept if options.afresh else None,
            lpips=options.lpips,
            workers=workers,
            steps=steps,
        )
        answered = answer(results, assumed=tuple(assumed))
        estimated = any(result.task.estimated for result in results)
        if not (options.afresh and answered.cause.named and estimated and len(results) > 1):
            return answered
        steps.again()
        extension = SimulatorExtension.of(answered.report, answered.pin_radius_m)
        anew = estimated_anew(captures, [r.task for r in answered.results], extension, kept, options.resolution_m)
        if not anew.tasks:
            return answered.having_spent(anew.cost, began, anew.said)
        results = workers.map(partial(explain_fabric, cache=kept), anew.tasks)
        return _better(answered, anew, partial(answer, results), began)


def _better(first: Diagnosis, anew: Anew, answer: Callable[..., Diagnosis], began: float) -> Diagnosis:
    """What a second round answers, ``anew`` its fabrics, if that says more than the ``first``; else the first."""
    spent = first.cost_in_all()
    spent.add(anew.cost)
    again = answer(assumed=(*first.given, *anew.said), spent=spent)
    if says_more(again.report, first.report):
        return replace(again, pin_radius_m=first.pin_radius_m)
    return first.having_spent(cost_of(again.results, again.looks, anew.cost), began, (NO_MORE,))


def conclude(
    results: Sequence[FabricResult],
    effects: tuple[str, ...],
    assumed: tuple[str, ...] = (),
    began: float | None = None,
    *,
    cache: DrapeCache | None = None,
    lpips: bool = False,
    workers: Workers = ALONE,
    steps: Steps = UNTOLD,
    spent: Cost | None = None,
) -> Diagnosis:
    """From simulations to the report.

    Args:
        results: of all fabrics.
        effects: names that were tried.
        assumed: what had to be, in words.
        began: when the work began (monotonic), for the report's cost.
        cache: where fresh simulations of what may be named are kept; None: statistics alone.
        lpips: measure the shrinkage in LPIPS, too; needs ``cache``.
        workers: that simulate fabrics side by side.
        steps: told how far it is.
        spent: on a first round, which has settled how magnets hold; None: this is the first.
    """
    from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]  # it ships no type information

    with threadpool_limits(1):  # small matrices: more threads cost more than they give
        looks = {} if cache is None else {r.task.id: FreshLook(Simulator(cache), r) for r in results}
        return _Conclusion(effects, workers, steps).of(list(results), looks, assumed, began, lpips, spent)


@dataclass(frozen=True)
class _Conclusion:
    """Statistics under one set of assumptions.

    Attributes:
        effects: names that are tried.
        workers: that simulate fabrics side by side.
        steps: told how far it is.
        noise: the usual errors; the captures may make smaller ones likely (:mod:`diagnosis.inference.granted`).
        model: of the likelihood.
    """

    effects: tuple[str, ...]
    workers: Workers
    steps: Steps = UNTOLD
    noise: NoiseModel = NoiseModel()
    model: LikelihoodModel = LikelihoodModel()

    def of(
        self,
        results: list[FabricResult],
        looks: dict[str, FreshLook],
        assumed: tuple[str, ...],
        began: float | None,
        lpips: bool,
        spent: Cost | None = None,
    ) -> Diagnosis:
        """The whole report.

        ``spent``: what was simulated for it with magnets that turned out to hold otherwise, or with first estimates.
        """
        given = assumed
        noise = replace(self.noise, pin_m=pin_scatter([c for r in results for c in r.captures], self.noise))
        name = once(partial(self.name, noise=noise))
        pin = False
        if len(looks) > 1:  # with one fabric a wrong parameter and an effect look alike: no closer look helps
            scene = "stretch" if any(c.scene == "stretch" for r in results for c in r.captures) else "hanging"
            looks, held = self._looked_at(looks, name, scene, noise, grip=spent is None)
            if held is not None and held.otherwise:
                return self._held_otherwise(held, looks, assumed, began, lpips)
            results = [look.result for look in looks.values()]
            self.steps.look(LOOKS)
            pin = outdone_by_a_pin(looks, name(results), self.effects, scene, self.workers)
        cause = name(results).outdone() if pin else name(results)
        noise = cause.errors
        blocks, pixels = make_blocks(results, noise), make_pixels(results, noise)
        close = all_alike(noise)
        weighed = make_blocks(results, close)
        folds = [
            replace(fold, rest=own.rest)
            for fold, own in zip(folds_of(results, blocks, noise), folds_of(results, weighed, close), strict=True)
        ]
        judge = Judge(looks, self.workers)

        def measure(of: Cause, *, known: bool = False, without: Collection[str] = ()) -> Measured | None:
            return measure_shrinkage(of, self.effects, folds, pixels, self.model, judge, known=known, without=without)

        self.steps.measure()
        cause, measured = judged(cause, measure, estimated=half_estimated(results))
        assumed = (*assumed, *said_of_states(results))  # of those that the answer rests on
        if measured is not None:
            assumed = (*assumed, *not_at_rest_with(measured.held, looks))
        if cause.named and measured is None:
            assumed = (*assumed, "one capture alone: none is held out, so how far the gap shrinks was not measured")
        shrinkage = None if measured is None else complete(measured, looks, lpips=lpips)
        before = spent or Cost()
        cost = cost_of(results, looks, before)
        assumed = (*assumed, *cost.cut_short())
        report = GapReport(
            gap=detect(blocks, pixels, cause, self.model),
            where=where_gaps(blocks, pixels, cause, self.model),
            cause=cause_report(cause, blocks, pixels, self.model),
            shrinkage=shrinkage,
            parameters_refitted=True,
            cost=CostReport(
                simulations=cost.simulations,
                seconds=round(time.monotonic() - began, 2) if began is not None else cost.seconds,
                solver_seconds=round(cost.seconds, 2),
                cached=cost.cached,
            ),
            model_version=MODEL_VERSION,
            assumed=assumed,
        )
        left_out = () if measured is None else measured.held
        return Diagnosis(
            report, tuple(results), tuple(blocks), cause, pixels, assumed, left_out, looks, spent=before, given=given
        )

    def _looked_at(
        self, looks: dict[str, FreshLook], name: Name, scene: str, noise: NoiseModel, *, grip: bool
    ) -> tuple[dict[str, FreshLook], Grip | None]:
        """Fabrics as closer looks leave them, cut short where magnets hold otherwise; how they do, if ``grip`` asks."""
        weigh, workers = partial(self.weigh, noise=noise), self.workers
        first: tuple[Look, ...] = (
            lambda seen: look_again(seen, weigh, scene, workers),
            lambda seen: look_alike(seen, weigh, name, scene, workers),
            lambda seen: look_further(seen, weigh, name, scene, workers),
            lambda seen: look_between(seen, weigh, name, scene, workers),
        )
        for number, look in enumerate(first, start=1):
            self.steps.look(number)
            looks = look(looks)
        likely = name([look.result for look in looks.values()])
        held = judge_grip(looks, likely, workers) if grip else None
        if held is not None and held.otherwise:
            return looks, held
        then: tuple[Look, ...] = (
            lambda seen: look_beside(seen, likely, scene, workers),
            lambda seen: look_together(seen, name, scene, workers),
            lambda seen: look_through(seen, weigh, name, scene, workers),
            lambda seen: look_for_second(seen, name, scene, workers),
            lambda seen: look_probed(seen, weigh, name, scene, workers),
        )
        for number, look in enumerate(then, start=len(first) + 1):
            self.steps.look(number)
            looks = look(looks)
        return looks, held

    def _held_otherwise(
        self, held: Grip, looks: dict[str, FreshLook], assumed: tuple[str, ...], began: float | None, lpips: bool
    ) -> Diagnosis:
        """Everything again with magnets that hold the cloth the other way."""
        results = [look.result for look in looks.values()]
        first = next(look for look in looks.values())
        stated = first.result.task.captures[0].scene.setup.pin_radius_m
        cache = first.simulator.cache
        again = self.workers.map(partial(explain_fabric, cache=cache), [with_other_grip(r.task) for r in results])
        new = {r.task.id: FreshLook(Simulator(cache), r) for r in again}
        other = again[0].task.captures[0].scene.setup.pin_radius_m
        said = (*assumed, held.sentence(stated, other))
        found = self.of(again, new, said, began, lpips, spent=cost_of(results, looks, Cost()))
        return replace(found, pin_radius_m=other)

    def name(self, results: Sequence[FabricResult], noise: NoiseModel) -> Cause:
        """All explanations weighed, two effects together included, under the errors that the captures make likely."""

        def weigh(errors: NoiseModel) -> Cause:
            blocks = make_blocks(results, all_alike(errors))
            return name_cause(self.effects, blocks, make_pixels(results, errors), self.model)

        return likeliest(weigh, noise)

    def weigh(self, results: Sequence[FabricResult], beside: Sized | None, noise: NoiseModel) -> Cause:
        """Single effects alone, to choose what is simulated: their responses are not yet trusted in any scene.

        Nor are errors taken for smaller than usual, since those of coarse responses are not.
        """
        blocks, pixels = make_blocks(results, all_alike(noise)), make_pixels(results, noise)
        if beside is not None:
            blocks = [without(block, *beside) for block in blocks]
            pixels = pixels_without(pixels, *beside)
        return name_cause(self.effects, blocks, pixels, replace(self.model, moved_stretch=ROUGH), pairs=False)
