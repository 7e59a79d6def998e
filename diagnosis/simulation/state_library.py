"""The fold states of a fabric in a set-up that are known so far, kept beside the drapes."""

from __future__ import annotations

import json
from dataclasses import dataclass

import numpy as np
from filelock import FileLock

from diagnosis.scene import SimulationScene
from diagnosis.simulation.drape_cache import DrapeCache, drape_key
from diagnosis.simulation.simulator import KeyedDrape
from renderer.atomic import write_atomically
from simcore.drape import Drape
from simcore.mesh import GridMesh
from simcore.parameters import FabricParameters

SAME_STATE_M = 0.0002
MOST_STATES = 24


def vertex_rms(a: Drape, b: Drape) -> float:
    """Root mean square distance between vertices of two drapes of one mesh [m]."""
    return float(np.sqrt(np.mean(np.sum((a.vertices - b.vertices) ** 2, axis=1))))


@dataclass(frozen=True)
class StateLibrary:
    """States of one fabric, set-up and mesh; what hangs on a state's key is found again as long as the state is.

    Attributes:
        cache: where drapes are kept.
        mesh: their mesh.
        name: key of the collection.
    """

    cache: DrapeCache
    mesh: GridMesh
    name: str

    @classmethod
    def of(cls, cache: DrapeCache, mesh: GridMesh, fabric: FabricParameters, scene: SimulationScene) -> StateLibrary:
        """The collection that belongs to a simulation."""
        return cls(cache, mesh, drape_key(mesh, fabric, scene.setup, scene.mechanics, start="library"))

    def states(self) -> list[KeyedDrape]:
        """All states that were added and can still be read."""
        found = []
        for key in self._keys():
            drape = self.cache.get(key, self.mesh)
            if drape is not None:
                found.append(KeyedDrape(drape, key))
        return found

    def add(self, state: KeyedDrape) -> None:
        """Keep a state that a capture showed."""
        if self.cache.folder is None or not self.cache.learns or state.key in self._keys():
            return
        path = self.cache.folder / "states" / f"{self.name}.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        with FileLock(f"{path}.lock"):  # another process may add one of its own
            keys = [key for key in self._keys() if self.cache.has(key)]  # of those gone since, nothing is learnt
            if state.key not in keys and len(keys) < MOST_STATES:
                write_atomically(path, json.dumps([*keys, state.key]).encode())

    def _keys(self) -> list[str]:
        if self.cache.folder is None:
            return []
        try:
            return list(json.loads((self.cache.folder / "states" / f"{self.name}.json").read_text(encoding="utf-8")))
        except (OSError, ValueError):
            return []
