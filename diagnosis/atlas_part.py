"""The parts of an atlas: one fold state each, put up from one seed, with all its variations; none needs another."""

from __future__ import annotations

from dataclasses import dataclass, replace

from capture.capture_set import CaptureSet
from diagnosis.scene import SimulationScene
from diagnosis.simulation.drape_cache import DrapeCache, drape_key
from diagnosis.simulation.responses import are_kept
from diagnosis.simulation.simulator import Cost, KeyedDrape, Simulator
from diagnosis.tasks.fabric_task import BASE_JITTER, BASE_SEEDS, FabricTask, see_state
from diagnosis.tasks.planned import planned_tasks
from simcore.mesh import GridMesh


@dataclass(frozen=True)
class AtlasPart:
    """A sample put up from one seed, and what changes in its picture when anything else changes.

    Attributes:
        task: fabric, effects to try and mesh; without captures.
        scene: set-up and camera, without effects.
        seed: of the placement.
    """

    task: FabricTask
    scene: SimulationScene
    seed: int

    def is_ready(self, cache: DrapeCache) -> bool:
        """All of it is kept."""
        mesh, scene = self._mesh(), self.scene
        key = drape_key(mesh, self.task.parameters, scene.setup, scene.mechanics, seed=self.seed, jitter=BASE_JITTER)
        kept = cache.get(key, mesh)
        if kept is None or not kept.ok:
            return kept is not None
        return are_kept(cache, KeyedDrape(kept, key), scene, self.task.effects)

    def solve(self, cache: DrapeCache) -> Cost:
        """Solve what is not kept; a state that does not come to rest has no variations."""
        simulator = Simulator(cache)
        base = simulator.put_up(self._mesh(), self.task.parameters, self.scene, self.seed, BASE_JITTER)
        if base.drape.ok:
            see_state(simulator, self.task, self.scene, base)
        return simulator.cost

    def _mesh(self) -> GridMesh:
        return GridMesh(self.task.resolution_m, self.scene.setup.sample_size_m)


def atlas_parts(captures: CaptureSet, effects: tuple[str, ...], resolution_m: float) -> list[AtlasPart]:
    """All parts for a set's fabrics, scenes and cameras; pictures need not be there where the set states the rest.

    Raises:
        InputError: see :func:`diagnosis.tasks.planned.planned_tasks`.
    """
    parts = []
    for task in planned_tasks(captures, effects, resolution_m)[0]:
        scenes = [capture.scene for capture in task.captures]
        for scene in (s for n, s in enumerate(scenes) if s not in scenes[:n]):
            seeds = range(BASE_SEEDS[scene.setup.scene.value])
            parts += [AtlasPart(replace(task, captures=()), scene, seed) for seed in seeds]
    return parts
