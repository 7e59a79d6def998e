"""Simulations that do not depend on the captures, in a folder that says which version made them; and their cost."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from diagnosis.afresh import alike, between
from diagnosis.afresh.fresh import is_mechanical, moves_camera
from diagnosis.afresh.further import FURTHER, TRIAL_LOOKS
from diagnosis.afresh.moved_pin import MOST_TRIALS
from diagnosis.afresh.refinement import CLOTH_EFFECTS, LOOKS, PICTURE_ROUNDS
from diagnosis.afresh.second import MOST_SIZES, SECOND_EFFECTS
from diagnosis.afresh.through import THROUGH_PAIRS, THROUGH_ROUNDS
from diagnosis.afresh.together import PAIR_ROUNDS, ROUND_PAIRS
from diagnosis.atlas_part import AtlasPart
from diagnosis.effect import Stage
from diagnosis.effects import get_effect
from diagnosis.simulation.base_state import STARTS
from diagnosis.simulation.drape_cache import DrapeCache, drape_key
from diagnosis.simulation.missed_folds import FURTHER_SEEDS
from diagnosis.simulation.probes import PROBES
from diagnosis.simulation.responses import are_at_hand
from diagnosis.simulation.simulator import Cost, KeyedDrape
from diagnosis.simulation.sizes import aside, at_likeliest_places, nodes, shortcuts
from diagnosis.tasks.fabric_task import BASE_JITTER, BASE_SEEDS, FabricTask
from diagnosis.version import LED_VERSION, PIXELS_VERSION, RESPONSES_VERSION
from renderer.atomic import write_atomically
from simcore.errors import InputError
from simcore.mesh import GridMesh
from simcore.version import SOLVER_VERSION

ATLAS_FILE = "atlas.json"
FORMAT = "drape-atlas/1"
SECONDS_A_BASE, SECONDS_A_VARIATION, SECONDS_A_SEARCH = 2.0, 0.15, 1.5
"""CPU seconds of a drape put up at 10 mm, of one that goes on at 20 mm, and of a state led by a capture (see bench)."""


@dataclass(frozen=True)
class Forecast:
    """What a diagnosis will cost.

    Attributes:
        simulations: still to be solved, about, where all captures of a fabric in a scene show the same folds.
        seconds: CPU seconds that takes, about.
        most_simulations, most_seconds: the same where each capture shows folds of its own, which bring their own
            responses and are probed for something unknown, where looking closer changes which effects are looked at,
            where an effect is found on trial, where one on the cloth leads, beside which others are looked for, and
            where a capture's folds are missed at first; without what goes on from nearer folds once such are found.
        ready: fabrics whose base states are already at hand.
        fabrics: of the set.
        estimated: parameters are, so that a named effect brings a second round.
    """

    simulations: int
    seconds: float
    most_simulations: int
    most_seconds: float
    ready: int
    fabrics: int
    estimated: bool = False

    def sentence(self) -> str:
        """For the user, before the work."""
        again = ", and where an effect is named, with which parameters are estimated again" if self.estimated else ""
        return (
            f"{self.simulations} to {self.most_simulations} simulations, {self.seconds:.0f} to {self.most_seconds:.0f} "
            "CPU seconds, by how many fold states the captures show (twice that where magnets hold the cloth otherwise "
            f"than stated{again}); "
            f"the atlas holds {self.ready} of {self.fabrics} fabrics"
        )


def open_atlas(folder: Path) -> DrapeCache:
    """An atlas's drapes and responses; an empty folder becomes an atlas.

    Raises:
        InputError: the folder's atlas is of another version, or no atlas.
    """
    here = _versions()
    path = folder / ATLAS_FILE
    if path.exists():
        try:
            there = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            there = None
        if there != here:
            raise InputError(
                f"{folder}: the atlas is of another version ({there}) than this program ({here}): build one with "
                "`drapemeter diagnose CAPTURE_SET --build-atlas --atlas NEW_FOLDER`",
                code="atlas_version",
            )
    elif folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder} is no atlas: give an empty or a new folder", code="atlas_invalid")
    else:
        folder.mkdir(parents=True, exist_ok=True)
        write_atomically(path, (json.dumps(here) + "\n").encode())
    return DrapeCache(folder / "drapes")


PartSolver = Callable[[Sequence[AtlasPart], DrapeCache], Iterator[Cost]]
"""Solves parts into a cache and tells what each cost when it is kept."""


def solve_here(parts: Sequence[AtlasPart], cache: DrapeCache) -> Iterator[Cost]:
    """One after the other, in this process."""
    for part in parts:
        yield part.solve(cache)


def build_atlas(
    parts: Sequence[AtlasPart],
    cache: DrapeCache,
    on_part: Callable[[float], None] | None = None,
    solve: PartSolver = solve_here,
) -> Cost:
    """Solve the parts of an atlas that are not there yet; each is kept when it is done, so a stopped build goes on.

    Args:
        parts: of :func:`diagnosis.atlas_part.atlas_parts`.
        cache: of :func:`open_atlas`.
        on_part: called with 1 for every part that is there.
        solve: who does the work.
    """
    total = Cost()
    missing = [part for part in parts if not part.is_ready(cache)]
    told = on_part or (lambda _: None)
    told(float(len(parts) - len(missing)))
    for cost in solve(missing, cache):
        total.add(cost)
        told(1.0)
    return total


def forecast(tasks: Sequence[FabricTask], cache: DrapeCache) -> Forecast:
    """About what a diagnosis of these fabrics costs with what the cache holds."""
    counts, most = np.zeros(3, dtype=int), np.zeros(3, dtype=int)
    ready = 0
    for task in tasks:
        at_hand = _at_hand(task, cache)
        ready += at_hand
        for name in {capture.scene.setup.scene.value for capture in task.captures}:
            own = [c for c in task.captures if c.scene.setup.scene.value == name]
            closer = name == "stretch" and len(tasks) > 1  # with one fabric nothing is looked at closer
            looks = CLOTH_EFFECTS if closer else 0
            further = LOOKS + alike.most_looks(task.effects) + TRIAL_LOOKS if closer else 0
            further += between.most_looks(task.effects) if closer else 0
            pairs = PAIR_ROUNDS * ROUND_PAIRS + THROUGH_ROUNDS * THROUGH_PAIRS
            further += pairs + SECOND_EFFECTS if closer else 0
            if len(tasks) > 1:
                further += PICTURE_ROUNDS * sum(moves_camera(effect) for effect in task.effects) * STARTS[name]
            beside = _beside(task.effects) if closer else 0
            pins = len(own[0].scene.setup.pins_m)
            beside += sum(PROBES.values()) + 2 * pins if closer else 0
            one = _variations(task.effects, name, pins)
            states = 1 if name == "hanging" else int(not at_hand)  # there, a capture leads to a state of its own
            bases = 0 if at_hand else BASE_SEEDS[name]
            counts += (bases, states * one, 1 + looks)
            tried = FURTHER + SECOND_EFFECTS * MOST_SIZES + MOST_TRIALS if closer else 0
            tried += between.most_trials(task.effects) if closer else 0
            missed, again = (len(FURTHER_SEEDS), STARTS[name]) if name == "stretch" else (0, 0)
            if not all(capture.pose_known for capture in own):  # led and compared again with the pose found again
                counts += (0, 0, 1)
                most += (0, len(own) * one, len(own))
            most += (bases + missed, len(own) * (one + beside) + tried, len(own) * (1 + further + again) + missed)
    each = np.array([SECONDS_A_BASE, SECONDS_A_VARIATION, SECONDS_A_SEARCH])
    totals = [(int(number.sum()), float(number @ each)) for number in (counts, most)]
    estimated = len(tasks) > 1 and any(task.estimated for task in tasks)
    return Forecast(*totals[0], *totals[1], ready, len(tasks), estimated)


def _variations(effects: Sequence[str], scene: str, pins: int) -> int:
    count = 8 + 2 * pins
    for name in effects:
        effect = get_effect(name)
        if effect.stage in (Stage.FABRIC, Stage.SETUP, Stage.ENVIRONMENT):
            halves = shortcuts(effect)
            likely = len(halves.keys() - aside(effect))
            saved = len(halves) - (likely if scene == "stretch" else 0)
            count += len(nodes(effect)) - saved + (likely if scene == "stretch" and not effect.fine else 0)
    return count


def _beside(effects: Sequence[str]) -> int:
    """Variations of a state with an effect on, beside which others are looked for."""
    able = [at_likeliest_places(get_effect(name)) for name in effects if is_mechanical(get_effect(name))]
    return sum(len(nodes(effect)) - len(shortcuts(effect)) for effect in able)


def _at_hand(task: FabricTask, cache: DrapeCache) -> bool:
    """Whether the first state of each of a fabric's scenes is there, with all its variations."""
    for capture in task.captures:
        scene = capture.scene
        mesh = GridMesh(task.resolution_m, scene.setup.sample_size_m)
        key = drape_key(mesh, task.parameters, scene.setup, scene.mechanics, seed=0, jitter=BASE_JITTER)
        kept = cache.get(key, mesh)
        if kept is None:
            return False
        if kept.ok and not are_at_hand(cache, task.parameters, KeyedDrape(kept, key), scene, task.effects):
            return False
    return True


def _versions() -> dict[str, Any]:
    return {
        "format": FORMAT,
        "simulation": SOLVER_VERSION,
        "responses": RESPONSES_VERSION,
        "pixels": PIXELS_VERSION,
        "led": LED_VERSION,
    }
