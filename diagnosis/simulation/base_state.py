"""The simulated fold state that is nearest to a capture."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from diagnosis.measurement.picture import noise_square, state_distance
from diagnosis.scene import SimulationScene
from diagnosis.simulation.simulator import KeyedDrape, Simulator
from diagnosis.simulation.state_library import SAME_STATE_M, StateLibrary, vertex_rms
from simcore.errors import SimulationError
from simcore.parameters import FabricParameters

STARTS = {"hanging": 1, "stretch": 3}
"""Of so many of the nearest states, one after the other, the capture's heights lead on: each may end in other folds."""
GOOD_ENOUGH_M = {"hanging": 0.003, "stretch": 0.0004}
"""A state whose difference from the capture is noise but for this needs no further search."""


def nearest_state(
    simulator: Simulator,
    fabric: FabricParameters,
    scene: SimulationScene,
    depth: NDArray[np.float32],
    candidates: list[KeyedDrape],
    enough: Mapping[str, float] | None = None,
) -> tuple[KeyedDrape, float]:
    """The nearest of some fold states and of the equilibrium that the solver finds when led by the capture's heights.

    Args:
        simulator, fabric, scene: what is simulated.
        depth: of the capture [m].
        candidates: states put up without the capture; at least one.
        enough: by key of a state, the distance [m] within which no nearer one is looked for.

    Returns:
        The drape and its root mean square difference from the capture [m].

    Raises:
        SimulationError: all candidates have diverged.
    """
    library = StateLibrary.of(simulator.cache, candidates[0].drape.mesh, fabric, scene)
    finite = [state for state in (*library.states(), *candidates) if np.isfinite(state.drape.vertices).all()]
    if not finite:
        raise SimulationError(
            f"no drape of this fabric can be simulated: {candidates[0].drape.reason}", code="diverged"
        )
    known = _distinct(sorted(finite, key=lambda state: not state.drape.ok))  # at rest before the same that is not
    scored = [(state_distance(depth, c.drape, scene), n, c) for n, c in enumerate(known)]
    best = min(scored)[2]
    name = scene.setup.scene.value
    near = max((enough or {}).get(best.key, 0.0), math.sqrt(noise_square(scene) + GOOD_ENOUGH_M[name] ** 2))
    settled = name == "hanging" and bool(enough)  # its folds are noise: one search a fabric and set-up
    for _, _, start in [] if settled else sorted(scored)[: STARTS[name]]:
        if min(scored)[0] <= near:
            break
        led = simulator.led(start, fabric, scene, depth)
        if led.drape.ok:
            led = next((k for k in known if k.drape.ok and vertex_rms(k.drape, led.drape) < SAME_STATE_M), led)
            scored.append((state_distance(depth, led.drape, scene), len(scored), led))
    usable = [entry for entry in scored if entry[2].drape.ok] or scored
    rms, _, best = min(usable)
    library.add(best)
    return best, rms


def _distinct(states: list[KeyedDrape]) -> list[KeyedDrape]:
    """Without states that are the same as an earlier one."""
    kept: list[KeyedDrape] = []
    for state in states:
        if all(vertex_rms(state.drape, other.drape) >= SAME_STATE_M for other in kept):
            kept.append(state)
    return kept
