"""A wider search for the folds of a capture that the first search missed.

Put up with the magnets where they are stated, a sample comes to rest in few of its fold states. A soft fabric in
``stretch`` has many, and a person's magnets, a millimetre off, choose among them: so further samples are put up with
magnets that are off, which are then brought to where they are stated.
"""

from __future__ import annotations

from collections.abc import Sequence

from diagnosis.scene import SimulationScene
from diagnosis.simulation.simulator import KeyedDrape, Simulator
from simcore.mechanics import Jitter
from simcore.mesh import GridMesh
from simcore.parameters import FabricParameters

FURTHER_SEEDS = range(100, 112)
FURTHER_JITTER = Jitter()
MISSED_M, MISSED_ALONE_M = 0.001, 0.002
"""Beyond its best repeat, or beyond the sensor's noise where it has none, a capture's distance from its state."""


def is_missed(square_m2: float, repeats_m2: Sequence[float], scene: SimulationScene) -> bool:
    """Whether a capture shows folds that were not found.

    What an effect or a wrong parameter does it does to all repeats; what is far from its state in one alone fell
    otherwise. In ``hanging`` folds are noise.

    Args:
        square_m2: of the capture's distance from its state, less the sensor's noise, which need not be the same in all.
        repeats_m2: the same of all repeats put up alike, itself included.
        scene: of the capture.
    """
    if scene.setup.scene.value != "stretch":
        return False
    if len(repeats_m2) < 2:
        return square_m2 > MISSED_ALONE_M**2
    return square_m2 > min(repeats_m2) + MISSED_M**2


def further_states(
    simulator: Simulator, fabric: FabricParameters, scene: SimulationScene, mesh: GridMesh
) -> list[KeyedDrape]:
    """Fold states of further samples, magnets where they are stated."""
    put_up = [simulator.put_up(mesh, fabric, scene, seed, FURTHER_JITTER) for seed in FURTHER_SEEDS]
    settled = [simulator.proceed(state, fabric, scene) for state in put_up if state.drape.ok]
    return [state for state in settled if state.drape.ok]
