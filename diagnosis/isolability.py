"""Which effects given captures can tell apart, known before anything is captured: from simulated responses alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from capture.capture_set import CaptureSet
from capture.setup import setup_from_document
from diagnosis.effects import get_effect
from diagnosis.inference.block import Block, PixelBlock, make_block, make_pixel_block
from diagnosis.inference.likelihood import LikelihoodModel
from diagnosis.inference.noise import NoiseModel
from diagnosis.measurement.picture import picture_of
from diagnosis.separation import SEPARABLE_NATS, Separation, own_nats, separations
from diagnosis.simulation.drape_cache import DrapeCache
from diagnosis.simulation.simulator import Simulator
from diagnosis.tasks.fabric_task import CaptureTask, FabricResult, FabricTask, base_states, explain_fabric
from diagnosis.tasks.planned import planned_tasks
from diagnosis.tasks.put_up import as_simulated
from simcore.errors import InputError
from simcore.mesh import GridMesh
from simcore.scenes import Scene


@dataclass(frozen=True)
class Isolability:
    """What captures of some fabrics and scenes can tell apart; from simulations alone.

    Attributes:
        pairs: every effect but those left out, at a typical size, against every other one, the worst first; an effect
            that changes nothing at all in these scenes has none.
        scenes: the scenes that were analysed.
        own_nats: the same effects against no effect.
        left_out: effects that differ from repeat to repeat: they widen the scatter in no direction of their own, and
            whether one is there hangs on the number of repeats.
        by_scene: scene to (effect, other) to the nats that this scene alone gives: of every scene that was analysed,
            and of the one that the captures lack where some effect that shows cannot be told from another.
        assumed: in words, what the set does not state.
    """

    pairs: tuple[Separation, ...]
    scenes: tuple[str, ...]
    own_nats: Mapping[str, float]
    left_out: tuple[str, ...] = ()
    by_scene: Mapping[str, Mapping[tuple[str, str], float]] = field(default_factory=dict)
    assumed: tuple[str, ...] = ()

    def confused(self) -> tuple[Separation, ...]:
        """The pairs that cannot be told apart."""
        return tuple(p for p in self.pairs if p.nats < SEPARABLE_NATS)

    def invisible(self) -> tuple[str, ...]:
        """Effects whose own response drowns in the errors."""
        return tuple(sorted(name for name, nats in self.own_nats.items() if nats < SEPARABLE_NATS))


def analyse(
    captures: CaptureSet,
    effects: tuple[str, ...],
    resolution_m: float,
    cache: DrapeCache,
    on_fabric: Callable[[float], None] | None = None,
) -> Isolability:
    """Before (or without) looking at what the captures show: fabrics, scenes, camera and sensor as the set states them.

    No picture need be there where the set states parameters, density and pose (:mod:`diagnosis.tasks.planned`).

    Args:
        captures: taken or planned.
        effects: names; those that differ from repeat to repeat are left out.
        resolution_m: wanted edge of a mesh cell.
        cache: of simulations.
        on_fabric: called with 1 for every fabric.

    Raises:
        InputError: captures that cannot be used, or a plan that does not state what pictures would have to tell.
        SimulationError: simulations that do not come to rest.
    """
    tasks, assumed = planned_tasks(captures, effects, resolution_m)
    taken = {c.scene.setup.scene for task in tasks for c in task.captures}
    lacking = next((scene for scene in Scene if scene not in taken), None)
    elsewhere = [] if lacking is None else [in_scene(captures, task, lacking) for task in tasks]
    results = []
    for task in tasks:
        results.append(_simulated(task, cache))
        if on_fabric is not None:
            on_fabric(1.0)
    typical = {name: get_effect(name).typical() for name in effects if not get_effect(name).random_repeats}
    model = LikelihoodModel()
    blocks, pixels = _responses(results)
    found = Isolability(
        tuple(sorted(separations(typical, blocks, pixels, model), key=lambda p: p.nats)),
        tuple(sorted({b.scene for b in blocks})),
        own_nats(typical, blocks, pixels, model),
        tuple(name for name in effects if name not in typical),
        assumed=tuple(assumed),
    )
    seen = [p for p in found.confused() if p.effect not in found.invisible()]
    by_scene = {scene: _alone(typical, results, scene) for scene in found.scenes}
    if seen and lacking is not None:  # would captures there tell them apart?
        there = [_simulated(task, cache) for task in elsewhere]
        by_scene[lacking.value] = _alone(typical, there, lacking.value)
    return replace(found, by_scene=by_scene)


def _simulated(task: FabricTask, cache: DrapeCache) -> FabricResult:
    """A fabric whose captures are its own simulations, as the sensor shows them."""
    simulator = Simulator(cache)
    shown: list[CaptureTask] = []
    for capture in task.captures:
        mesh = GridMesh(task.resolution_m, capture.scene.setup.sample_size_m)
        base = base_states(simulator, task.parameters, capture.scene, mesh)[0]
        rng = np.random.default_rng(len(shown))
        picture = picture_of(base.drape, capture.scene)
        shown.append(replace(capture, depth=capture.scene.sensor.apply(picture, rng, camera=capture.scene.camera)))
    return explain_fabric(replace(task, captures=tuple(shown)), cache)


def in_scene(captures: CaptureSet, task: FabricTask, scene: Scene) -> FabricTask:
    """The same fabric, as often, in another scene with the pins that the set states for it.

    Raises:
        InputError: no sample can be put up so.
    """
    entries = {capture.id: capture.document for capture in captures.captures}
    there = []
    for capture in task.captures:
        name = f"{capture.id} in {scene.value}"
        try:
            setup = setup_from_document(scene, captures.stated_setup(entries[capture.id]))
        except InputError as error:
            raise InputError(f"capture {name}: {error}", code=error.code) from None
        whole = as_simulated(name, setup, task.resolution_m)
        there.append(replace(capture, scene=capture.scene.with_setup(whole)))
    return replace(task, captures=tuple(there))


def _responses(results: Sequence[FabricResult], scene: str | None = None) -> tuple[list[Block], PixelBlock]:
    """Blocks and shared numbers of all captures, or of those of one scene."""
    noise = NoiseModel()
    found = [c for r in results for c in r.captures if scene in (None, c.scene)]
    blocks = [
        make_block([c for c in r.captures if c.scene == one], r.task.relative_sigma, noise)
        for r in results
        for one in sorted({c.scene for c in r.captures if scene in (None, c.scene)})
    ]
    return blocks, make_pixel_block(found, noise)


def _alone(
    typical: Mapping[str, Mapping[str, float]], results: Sequence[FabricResult], scene: str
) -> dict[tuple[str, str], float]:
    """Nats between effects by the captures of one scene."""
    blocks, pixels = _responses(results, scene)
    return {(p.effect, p.other): p.nats for p in separations(typical, blocks, pixels, LikelihoodModel())}
