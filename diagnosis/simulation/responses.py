"""What parameters, pins, the mesh and every effect change in the picture of a fold state; kept beside the drapes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from diagnosis.effect import Effect, Stage
from diagnosis.effects import get_effect
from diagnosis.measurement.picture import picture_of
from diagnosis.measurement.reference import Reference, make_reference
from diagnosis.scene import SimulationScene
from diagnosis.simulation.drape_cache import DrapeCache, content_key
from diagnosis.simulation.probes import probed
from diagnosis.simulation.simulator import KeyedDrape, Simulator
from diagnosis.simulation.sizes import aside, at_all_places, at_likeliest_places, node_values, nodes
from diagnosis.simulation.state_library import StateLibrary, vertex_rms
from diagnosis.simulation.variations import Variations, is_mended, on_own_cells, sensed
from diagnosis.version import PIXELS_VERSION, RESPONSES_VERSION
from simcore.parameters import FabricParameters

Array = NDArray[np.float64]
BORROW_M = {"hanging": 0.006, "stretch": 0.001}
"""Responses of a state that is nearer than this serve too."""
ENOUGH_STATES = {"hanging": 3, "stretch": 12}
"""Where so many states of a fabric have responses, the nearest one's serve whatever the distance."""


@dataclass(frozen=True)
class Responses:
    """Changes of the shape-and-plane vector (length D) of a state's picture.

    Attributes:
        parameters: for a relative change of one of each of the seven parameters, [7, D].
        pins: for a move of one metre of each pin along x and along y, [2 * pins, D].
        grip: from what the stated magnets hold to a point, or from a point to a patch, [D].
        mesh: from the fine mesh to one of twice the cell, [D]; zero where both are the same.
        effects: effect name to the change of (vector [nodes, D], pixel statistics [nodes, P]) at each of its nodes, of
            all places where it is tried.
        sensed: pixel statistics that the stated sensor gives on the state, [P].
        beside: (effect, other) to the same of the effect where the other one, at some size, is there, too.
        probes: by family, changes by what :mod:`diagnosis.simulation.probes` puts on the cloth, [probes, D]; empty
            where that was not looked at.
    """

    parameters: Array
    pins: Array
    grip: Array
    mesh: Array
    effects: Mapping[str, tuple[Array, Array]]
    sensed: Array
    beside: Mapping[tuple[str, str], tuple[Array, Array]] = field(default_factory=dict)
    probes: Mapping[str, Array] = field(default_factory=dict)


def find_responses(
    simulator: Simulator,
    fabric: FabricParameters,
    scene: SimulationScene,
    state: KeyedDrape,
    effects: Sequence[str],
    picture: NDArray[np.float32],
    reference: Reference,
) -> Responses:
    """Of the cache, or simulated: the state goes on with each parameter, pin and effect changed.

    Args:
        simulator: solves and keeps.
        fabric, scene: of the state.
        state: the fold state on the fine mesh.
        effects: names.
        picture: of the state, ideal [m].
        reference: its cells.
    """
    look = Variations(simulator, fabric, scene, state, picture, reference)
    common = simulator.kept(_common_key(state, scene), look.common)
    kept = {}
    for name in effects:
        effect = get_effect(name)
        rows = simulator.kept(_effect_key(effect, state, scene), partial(look.effect, effect))
        kept[name] = _everywhere(effect, rows)
    return Responses(
        common["parameters"],
        common["pins"],
        simulator.kept(_key("grip", state, scene), look.grip)["grip"],
        common["mesh"],
        kept,
        look.sensed.pixels,
    )


def borrowed_responses(
    simulator: Simulator,
    fabric: FabricParameters,
    scene: SimulationScene,
    state: KeyedDrape,
    effects: Sequence[str],
    picture: NDArray[np.float32],
    reference: Reference,
) -> Responses:
    """:func:`find_responses` of the nearest known state that has them, if it is near enough; else of this one."""
    lender = _lender(simulator, fabric, scene, state)
    if lender is not state:
        own = sensed(picture, scene, reference)
        picture = picture_of(lender.drape, scene)
        reference = make_reference(lender.drape, scene)
        found = find_responses(simulator, fabric, scene, lender, effects, picture, reference)
        return replace(found, sensed=own.pixels)  # what the sensor gives is known of the state itself
    return find_responses(simulator, fabric, scene, lender, effects, picture, reference)


def _lender(simulator: Simulator, fabric: FabricParameters, scene: SimulationScene, state: KeyedDrape) -> KeyedDrape:
    """The state whose responses serve a state: its own, or the nearest known one's that has them."""
    if simulator.cache.has(_common_key(state, scene)):
        return state
    known = StateLibrary.of(simulator.cache, state.drape.mesh, fabric, scene).states()
    able = [other for other in known if simulator.cache.has(_common_key(other, scene))]
    if able:
        name = scene.setup.scene.value
        nearest = min(able, key=lambda other: vertex_rms(state.drape, other.drape))
        if len(able) >= ENOUGH_STATES[name] or vertex_rms(state.drape, nearest.drape) < BORROW_M[name]:
            return nearest
    return state


def responses_with(
    simulator: Simulator,
    fabric: FabricParameters,
    scene: SimulationScene,
    state: KeyedDrape,
    without: Mapping[str, tuple[Array, Array]],
) -> dict[str, tuple[Array, Array]]:
    """What effects change where others are on already, at few sizes: (vector [nodes, D], pixel statistics [nodes, P]).

    Args:
        simulator: solves and keeps.
        fabric: of the state.
        scene: with the others on.
        state: the fold state with them on, on the fine mesh.
        without: what each effect changes where the others are not: at its less probable places, which are many, that
            is taken.
    """
    picture, reference = picture_of(state.drape, scene), make_reference(state.drape, scene)
    look = Variations(simulator, fabric, scene, state, picture, reference, sparing=True)
    found = {}
    for name, known in without.items():
        effect = at_likeliest_places(get_effect(name))
        key = content_key(few=True, full=_effect_key(effect, state, scene))
        own = _everywhere(effect, simulator.kept(key, partial(look.effect, effect)))
        found[name] = own if effect is get_effect(name) else _at_likeliest(get_effect(name), own, known)
    return found


def _at_likeliest(effect: Effect, own: tuple[Array, Array], known: tuple[Array, Array]) -> tuple[Array, Array]:
    """Rows at all places, those of the likeliest ones replaced."""
    places = [effect.tried.index(place) for place in at_likeliest_places(effect).places]
    count = len(node_values(effect))
    nodes_there = np.concatenate([np.arange(place * count, (place + 1) * count) for place in places])
    vector, pixels = (rows.copy() for rows in known)
    vector[nodes_there], pixels[nodes_there] = own
    return vector, pixels


def _everywhere(effect: Effect, rows: Mapping[str, Array]) -> tuple[Array, Array]:
    """Responses (vector, pixel statistics) of an effect at all places where it is tried."""
    return at_all_places(effect, rows["vector"]), at_all_places(effect, rows["pixels"])


def probe_responses(
    simulator: Simulator, fabric: FabricParameters, scene: SimulationScene, state: KeyedDrape
) -> dict[str, Array]:
    """What the probes change in the picture of a state, or of the one whose responses serve it, by family, [probes, D].

    On the state's own mesh: coarse cells do not tell them well enough.

    Args:
        simulator: solves and keeps.
        fabric, scene: of the state.
        state: the fold state.
    """
    lender = _lender(simulator, fabric, scene, state)
    picture, reference = picture_of(lender.drape, scene), make_reference(lender.drape, scene)
    look = Variations(simulator, fabric, scene, lender, picture, reference, fine=True)
    changed = [one for scenes in probed(scene).values() for one in scenes]
    key = content_key(what="probes", base=_key("probes", lender, scene), changed=changed)
    return simulator.kept(key, look.probes)


def are_at_hand(
    cache: DrapeCache, fabric: FabricParameters, state: KeyedDrape, scene: SimulationScene, effects: Sequence[str]
) -> bool:
    """Whether a state's responses, or those of another one that serve it, are at hand."""
    return are_kept(cache, _lender(Simulator(cache), fabric, scene, state), scene, effects)


def are_kept(cache: DrapeCache, state: KeyedDrape, scene: SimulationScene, effects: Sequence[str]) -> bool:
    """Whether a state's own responses are at hand, those to all these effects included."""
    keys = [_common_key(state, scene), _key("grip", state, scene)]
    return all(cache.has(key) for key in (*keys, *(_effect_key(get_effect(name), state, scene) for name in effects)))


def _key(what: str, state: KeyedDrape, scene: SimulationScene) -> str:
    return content_key(what=what, responses=RESPONSES_VERSION, state=state.key, scene=scene)


def _common_key(state: KeyedDrape, scene: SimulationScene) -> str:
    cells = {"fine": True} if on_own_cells(scene) else {}
    return content_key(what="common", base=_key("common", state, scene), **cells)


def _effect_key(effect: Effect, state: KeyedDrape, scene: SimulationScene) -> str:
    changed = [effect.apply(scene, size) for size in nodes(effect)]
    measured: dict[str, object] = {"pixels": PIXELS_VERSION} if effect.stage is Stage.SENSOR else {}
    if effect.white:
        measured["white"] = True
    cells: dict[str, object] = {}
    if effect.fine or effect.stage is Stage.CAMERA:
        cells["fine"] = True
    elif is_mended(effect, scene):
        cells["fine"] = "half sizes"
    if aside(effect):
        cells["aside"] = sorted(aside(effect))  # half sizes alone
    return content_key(what=effect.name, base=_key("effect", state, scene), changed=changed, **measured, **cells)
