"""Simulations that do not depend on the captures, in a folder that says which version made them; and their cost."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from capture.capture_set import CaptureSet
from diagnosis.drape_cache import DrapeCache, drape_key
from diagnosis.effect import Stage
from diagnosis.effects import get_effect
from diagnosis.fabric_task import BASE_JITTER, BASE_SEEDS, FabricTask, base_states, see_state
from diagnosis.preparation import prepare_tasks
from diagnosis.refinement import CANDIDATES, LATER_CANDIDATES, ROUNDS
from diagnosis.simulator import Cost, Simulator
from diagnosis.sizes import nodes, shortcuts
from diagnosis.version import RESPONSES_VERSION, SIMULATION_VERSION
from renderer.atomic import write_atomically
from simcore.errors import InputError
from simcore.mesh import GridMesh

ATLAS_FILE = "atlas.json"
FORMAT = "drape-atlas/1"
SECONDS_A_BASE, SECONDS_A_VARIATION, SECONDS_A_SEARCH = 2.0, 0.15, 1.5
"""CPU seconds of a drape put up at 10 mm, of one that goes on at 20 mm, and of a state led by a capture (see bench)."""


@dataclass(frozen=True)
class Forecast:
    """What a diagnosis will cost.

    Attributes:
        simulations: still to be solved, about, where the captures show folds that are at hand.
        seconds: CPU seconds that takes, about.
        most_simulations, most_seconds: the same where each capture shows folds of its own, which bring their own
            responses, and where looking closer changes which effects are looked at.
        ready: fabrics whose base states are already at hand.
        fabrics: of the set.
    """

    simulations: int
    seconds: float
    most_simulations: int
    most_seconds: float
    ready: int
    fabrics: int

    def sentence(self) -> str:
        """For the user, before the work."""
        return (
            f"{self.simulations} to {self.most_simulations} simulations, {self.seconds:.0f} to {self.most_seconds:.0f} "
            "CPU seconds, by how many fold states the captures show; "
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
        except ValueError:
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


def build_atlas(
    captures: CaptureSet,
    effects: tuple[str, ...],
    resolution_m: float,
    cache: DrapeCache,
    on_fabric: Callable[[float], None] | None = None,
) -> Cost:
    """Solve all base states of a set's fabrics and scenes with all their variations; what is there is not solved again.

    Raises:
        InputError: captures that cannot be used.
    """
    total = Cost()
    for task in prepare_tasks(captures, effects, resolution_m)[0]:
        simulator = Simulator(cache)
        scenes = [capture.scene for capture in task.captures]
        for scene in (s for n, s in enumerate(scenes) if s not in scenes[:n]):
            mesh = GridMesh(task.resolution_m, scene.setup.sample_size_m)
            for base in base_states(simulator, task.parameters, scene, mesh):
                if base.drape.ok:
                    see_state(simulator, task, scene, base)
        total.add(simulator.cost)
        if on_fabric is not None:
            on_fabric(1.0)
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
            looks = CANDIDATES if name == "stretch" else 0
            further = ROUNDS * (CANDIDATES + LATER_CANDIDATES) if name == "stretch" else 0
            one = _variations(task.effects, name, len(own[0].scene.setup.pins_m))
            states = min(len(own), 2) if name == "hanging" else int(not at_hand)
            bases = 0 if at_hand else BASE_SEEDS[name]
            counts += (bases, states * one, 1 + looks)
            most += (bases, len(own) * one, len(own) * (1 + further))
    each = np.array([SECONDS_A_BASE, SECONDS_A_VARIATION, SECONDS_A_SEARCH])
    totals = [(int(number.sum()), float(number @ each)) for number in (counts, most)]
    return Forecast(*totals[0], *totals[1], ready, len(tasks))


def _variations(effects: Sequence[str], scene: str, pins: int) -> int:
    count = 8 + 2 * pins
    for name in effects:
        effect = get_effect(name)
        if effect.stage in (Stage.FABRIC, Stage.SETUP, Stage.ENVIRONMENT):
            count += len(nodes(effect)) - (len(shortcuts(effect)) if scene == "hanging" else 0)
    return count


def _at_hand(task: FabricTask, cache: DrapeCache) -> bool:
    for capture in task.captures:
        scene = capture.scene
        mesh = GridMesh(task.resolution_m, scene.setup.sample_size_m)
        key = drape_key(mesh, task.parameters, scene.setup, scene.mechanics, seed=0, jitter=BASE_JITTER)
        if not cache.has(key):
            return False
    return True


def _versions() -> dict[str, Any]:
    return {"format": FORMAT, "simulation": SIMULATION_VERSION, "responses": RESPONSES_VERSION}
