"""Drapes for the diagnosis: solved once, cached, counted."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from diagnosis.scene import SimulationScene
from diagnosis.simulation.drape_cache import DrapeCache, content_key, drape_key
from diagnosis.simulation.guided import SPRINGS_PER_M, relax_towards, warp_to_picture
from diagnosis.version import LED_VERSION
from simcore.drape import Drape, DrapeStatus
from simcore.mechanics import NO_JITTER, Jitter
from simcore.mesh import FEWEST_CELLS, LARGEST_CELL_M, GridMesh
from simcore.parameters import FabricParameters
from simcore.solver import Solver

TIME_LIMIT_S = 20.0


@dataclass
class Cost:
    """What was spent: simulations solved now (not taken from the cache), their CPU seconds, and how many of them were
    stopped before they were at rest, for want of time.
    """

    simulations: int = 0
    cached: int = 0
    seconds: float = 0.0
    out_of_time: int = 0

    def add(self, other: Cost) -> None:
        """Take another account over."""
        self.simulations += other.simulations
        self.cached += other.cached
        self.seconds += other.seconds
        self.out_of_time += other.out_of_time

    def cut_short(self) -> list[str]:
        """What has to be said of simulations that ran out of time, in words."""
        if not self.out_of_time:
            return []
        return [
            f"{self.out_of_time} of {self.simulations} simulations were stopped after {TIME_LIMIT_S:g} CPU seconds, "
            "before they were at rest, and count as far as they came: use a coarser --resolution"
        ]


@dataclass(frozen=True)
class KeyedDrape:
    """A drape and the key of what it was made from."""

    drape: Drape
    key: str


_here = threading.local()


def solver_of(mesh: GridMesh) -> Solver:
    """The calling thread's solver of a mesh, made when first asked for."""
    solvers: dict[GridMesh, Solver] = _here.__dict__.setdefault("solvers", {})
    if mesh not in solvers:
        solvers[mesh] = Solver(mesh)
    return solvers[mesh]


@dataclass
class Simulator:
    """Drapes of the cache, or solved now by solvers that a thread keeps, one a mesh; it can be pickled.

    Attributes:
        cache: where drapes are kept.
        cost: account of what was solved.
    """

    cache: DrapeCache
    cost: Cost = field(default_factory=Cost)

    def put_up(
        self, mesh: GridMesh, fabric: FabricParameters, scene: SimulationScene, seed: int, jitter: Jitter = NO_JITTER
    ) -> KeyedDrape:
        """The sample put up afresh."""
        key = drape_key(mesh, fabric, scene.setup, scene.mechanics, seed=seed, jitter=jitter)
        cached = self._cached(key, mesh)
        if cached is not None:
            return cached
        began = time.process_time()
        drape = solver_of(mesh).solve(
            fabric, scene.setup, seed=seed, jitter=jitter, mechanics=scene.mechanics, time_limit_s=TIME_LIMIT_S
        )
        return self._keep(key, drape, began)

    def proceed(self, start: KeyedDrape, fabric: FabricParameters, scene: SimulationScene) -> KeyedDrape:
        """The drape that ``start`` turns into when fabric, set-up or mechanics change to these."""
        mesh = start.drape.mesh
        key = drape_key(mesh, fabric, scene.setup, scene.mechanics, start=start.key)
        cached = self._cached(key, mesh)
        if cached is not None:
            return cached
        began = time.process_time()
        drape = solver_of(mesh).solve(
            fabric,
            scene.setup,
            start=start.drape,
            jitter=NO_JITTER,
            mechanics=scene.mechanics,
            time_limit_s=TIME_LIMIT_S,
        )
        return self._keep(key, drape, began)

    def led(
        self, start: KeyedDrape, fabric: FabricParameters, scene: SimulationScene, depth: NDArray[np.float32]
    ) -> KeyedDrape:
        """The equilibrium found from ``start`` when a capture's heights lead (:mod:`diagnosis.simulation.guided`)."""
        mesh = start.drape.mesh
        plain = drape_key(mesh, fabric, scene.setup, scene.mechanics, start=start.key)
        how = {"springs": SPRINGS_PER_M, "led": LED_VERSION}
        key = content_key(plain=plain, depth=depth, pose=scene.pose, camera=scene.camera, **how)
        cached = self._cached(key, mesh)
        if cached is not None:
            return cached
        began = time.process_time()
        solver = solver_of(mesh)
        target, seen = warp_to_picture(start.drape, scene, depth)
        x = relax_towards(solver, fabric, scene, self.shaped(mesh, target).drape, target, seen)
        current = self.shaped(mesh, x).drape
        drape = solver.solve(
            fabric, scene.setup, start=current, jitter=NO_JITTER, mechanics=scene.mechanics, time_limit_s=TIME_LIMIT_S
        )
        return self._keep(key, drape, began)

    def coarser(self, fine: KeyedDrape, fabric: FabricParameters, scene: SimulationScene) -> KeyedDrape:
        """The same fold state on a mesh of twice the cell; ``fine`` itself where there is no such mesh."""
        mesh = fine.drape.mesh
        cells = (mesh.rows - 1, mesh.columns - 1)
        if any(n % 2 or n < 2 * FEWEST_CELLS for n in cells) or 2 * mesh.resolution_m > LARGEST_CELL_M:
            return fine
        half = GridMesh(2 * mesh.resolution_m, mesh.size_m)
        vertices = fine.drape.vertices.reshape(mesh.rows, mesh.columns, 3)[::2, ::2].reshape(-1, 3)
        return self.proceed(self.shaped(half, vertices, fine.key), fabric, scene)

    def shaped(self, mesh: GridMesh, vertices: NDArray[np.float64], origin: str | None = None) -> KeyedDrape:
        """Positions that are no equilibrium, to start from, [vertex_count, 3]; ``origin``: key of their source."""
        drape = Drape(mesh, vertices, DrapeStatus.NOT_STILL, float("inf"), 0.0, False, 0, 0.0, "given shape")
        return KeyedDrape(drape, content_key(vertices=vertices) if origin is None else content_key(coarser=origin))

    def kept(self, key: str, make: Callable[[], dict[str, NDArray[np.float64]]]) -> dict[str, NDArray[np.float64]]:
        """Arrays of the cache, or made now and kept; the same numbers either way.

        What was made of a simulation that ran out of time is not kept, as that one is not.
        """
        arrays = self.cache.get_arrays(key)
        if arrays is None:
            before = self.cost.out_of_time
            arrays = {name: value.astype(np.float32).astype(np.float64) for name, value in make().items()}
            if self.cost.out_of_time == before:
                self.cache.put_arrays(key, arrays)
        return arrays

    def _cached(self, key: str, mesh: GridMesh) -> KeyedDrape | None:
        drape = self.cache.get(key, mesh)
        if drape is None:
            return None
        self.cost.cached += 1
        return KeyedDrape(drape, key)

    def _keep(self, key: str, drape: Drape, began: float) -> KeyedDrape:
        self.cost.simulations += 1
        self.cost.seconds += time.process_time() - began
        if drape.reason.startswith("time limit"):  # the next machine may be faster
            self.cost.out_of_time += 1
        else:
            self.cache.put(key, drape)
        return KeyedDrape(drape, key)
