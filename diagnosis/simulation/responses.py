"""What parameters, pins, the mesh and every effect change in the picture of a fold state; kept beside the drapes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from diagnosis.effect import Effect, Stage
from diagnosis.effects import get_effect
from diagnosis.measurement.features import Features, measure
from diagnosis.measurement.picture import depth_rms, picture_of
from diagnosis.measurement.reference import Reference, make_reference
from diagnosis.scene import SimulationScene
from diagnosis.simulation.drape_cache import DrapeCache, content_key
from diagnosis.simulation.probes import probed
from diagnosis.simulation.simulator import KeyedDrape, Simulator
from diagnosis.simulation.sizes import aside, nodes, shortcuts
from diagnosis.simulation.state_library import StateLibrary, vertex_rms
from diagnosis.version import PIXELS_VERSION, RESPONSES_VERSION
from simcore.parameters import LIMITS, PARAMETER_NAMES, FabricParameters
from simcore.scenes import Setup

Array = NDArray[np.float64]
PARAMETER_STEP = 0.07
"""Relative change by which the responses to the seven parameters are found."""
PIN_STEP_M = 0.002
"""Move by which the responses to each pin's place are found."""
PATCH_RADIUS_M = 0.011
"""A magnet's patch: a corner and its neighbours on a 10 mm mesh."""
LARGEST_PATCH_M = 0.015
"""No magnet of the kind holds more: on coarser cells a patch is a point."""
COARSE_TOO_FAR_M = 0.004
"""A coarse state further from its fine origin than this fell into other folds and is not used."""
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
        effects: effect name to the change of (vector [nodes, D], pixel statistics [nodes, P]) at each of its nodes.
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
    look = _Look(simulator, fabric, scene, state, picture, reference)
    common = simulator.kept(_common_key(state, scene), look.common)
    kept = {}
    for name in effects:
        effect = get_effect(name)
        kept[name] = simulator.kept(_effect_key(effect, state, scene), partial(look.effect, effect))
    return Responses(
        common["parameters"],
        common["pins"],
        simulator.kept(_key("grip", state, scene), look.grip)["grip"],
        common["mesh"],
        {name: (rows["vector"], rows["pixels"]) for name, rows in kept.items()},
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
    simulator: Simulator, fabric: FabricParameters, scene: SimulationScene, state: KeyedDrape, effects: Sequence[str]
) -> dict[str, tuple[Array, Array]]:
    """What effects change where others are on already, at few sizes: (vector [nodes, D], pixel statistics [nodes, P]).

    Args:
        simulator: solves and keeps.
        fabric: of the state.
        scene: with the others on.
        state: the fold state with them on, on the fine mesh.
        effects: names.
    """
    picture, reference = picture_of(state.drape, scene), make_reference(state.drape, scene)
    look = _Look(simulator, fabric, scene, state, picture, reference, sparing=True)
    found = {}
    for name in effects:
        key = content_key(few=True, full=_effect_key(get_effect(name), state, scene))
        rows = simulator.kept(key, partial(look.effect, get_effect(name)))
        found[name] = (rows["vector"], rows["pixels"])
    return found


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
    look = _Look(simulator, fabric, scene, lender, picture, reference, fine=True)
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
        cells["aside"] = "half sizes alone"
    return content_key(what=effect.name, base=_key("effect", state, scene), changed=changed, **measured, **cells)


def on_own_cells(scene: SimulationScene) -> bool:
    """Small changes are simulated on the state's own cells.

    In `stretch`: coarse cells fall into other folds there, and are wrong by half of a change and more; in `hanging`
    folds that are not found are.
    """
    return scene.setup.scene.value == "stretch"


def is_mended(effect: Effect, scene: SimulationScene) -> bool:
    """To what it does on coarse cells is added what the state's own do otherwise at half its size."""
    able = effect.moves_cloth and effect.vanishes_at_zero and not effect.fine
    return able and on_own_cells(scene) and bool(shortcuts(effect))


@dataclass
class _Look:
    """Renders and measures variations of one state, simulated when first asked for."""

    simulator: Simulator
    fabric: FabricParameters
    scene: SimulationScene
    state: KeyedDrape
    picture: NDArray[np.float32]
    reference: Reference
    sparing: bool = False  # simulate the half sizes only, in any scene
    fine: bool = False  # on the state's own mesh

    @cached_property
    def on_fine_cells(self) -> _Look:
        """The same on the state's own mesh."""
        return replace(self, fine=True)

    @cached_property
    def origin(self) -> KeyedDrape:
        """The state on a mesh of twice the cell, where variations cost little; itself where it fell elsewhere."""
        if self.fine:
            return self.state
        coarse = self.simulator.coarser(self.state, self.fabric, self.scene)
        if not coarse.drape.ok or depth_rms(picture_of(coarse.drape, self.scene), self.picture) > COARSE_TOO_FAR_M:
            return self.state
        return coarse

    @cached_property
    def coarse(self) -> Reference:
        return make_reference(self.origin.drape, smaller(self.scene), least_pixels=3)

    @cached_property
    def base(self) -> Array:
        return self.vector(self.origin, self.scene)

    @cached_property
    def sensed(self) -> Features:
        return sensed(self.picture, self.scene, self.reference)

    def vector(self, drape: KeyedDrape, seen: SimulationScene) -> Array:
        return measure(picture_of(drape.drape, smaller(seen)), self.coarse, with_pixels=False).vector()

    def change(self, fabric: FabricParameters, scene: SimulationScene) -> Array:
        """Of the vector when the state goes on with another fabric or scene."""
        drape = self.origin
        if fabric != self.fabric or (scene.setup, scene.mechanics) != (self.scene.setup, self.scene.mechanics):
            drape = self.simulator.proceed(self.origin, fabric, scene)
        if not np.isfinite(drape.drape.vertices).all():  # it diverged: nothing can be said
            return np.zeros(len(self.base))
        return clean(self.vector(drape, scene) - self.base)

    def seen_by(self, scene: SimulationScene) -> Array:
        """Change of the vector when another camera sees the state itself, in all its pixels: nothing must be solved.

        What a moved camera changes is less than what coarse cells and half the pixels do at folds and edges.
        """
        return clean(measure(picture_of(self.state.drape, scene), self.reference, with_pixels=False).vector())

    def common(self) -> dict[str, Array]:
        """Parameters, pins and mesh."""
        look = self.on_fine_cells if on_own_cells(self.scene) else self
        stepped = [_stepped(self.fabric, k) for k in range(7)]
        parameters = [look.change(fabric, self.scene) / step for fabric, step in stepped]
        mesh = measure(picture_of(self.origin.drape, self.scene), self.reference, with_pixels=False).vector()
        return {"parameters": np.stack(parameters), "pins": look.pins(), "mesh": clean(mesh)}

    def pins(self) -> Array:
        """For a move of one metre of each pin along x and along y."""
        found = []
        for name, place in self.scene.setup.pins_m.items():
            for axis in range(2):
                moved = (place[0] + PIN_STEP_M * (axis == 0), place[1] + PIN_STEP_M * (axis == 1), place[2])
                scene = self.scene.with_setup(self.scene.setup.with_pins(**{name: moved}))
                found.append(self.change(self.fabric, scene) / PIN_STEP_M)
        return np.stack(found)

    def grip(self) -> dict[str, Array]:
        """Magnets that hold a point, or a patch where they are stated as points; on the fine mesh."""
        setup = self.scene.setup
        other = other_radius_m(setup, self.state.drape.mesh.resolution_m)
        drape = self.simulator.proceed(
            self.state, self.fabric, self.scene.with_setup(replace(setup, pin_radius_m=other))
        )
        return {"grip": clean(measure(picture_of(drape.drape, self.scene), self.reference, with_pixels=False).vector())}

    def probes(self) -> dict[str, Array]:
        """Of each family; pins per metre."""
        found = {
            family: np.stack([self.change(self.fabric, scene) for scene in scenes])
            for family, scenes in probed(self.scene).items()
        }
        return {"pins": self.pins(), **found}

    def effect(self, effect: Effect) -> dict[str, Array]:
        """One effect at all its nodes."""
        sizes = nodes(effect)
        still = np.zeros(len(self.sensed.pixels))
        rows: dict[int, tuple[Array, Array]] = {}
        few = aside(effect)
        sparing = self.sparing or self.scene.setup.scene.value == "hanging"
        plan = {n: way for n, way in self._shortcuts(effect).items() if sparing or n in few}
        mended = is_mended(effect, self.scene) and not self.fine
        look = self.on_fine_cells if effect.fine or (mended and self.sparing) else self
        for number, size in enumerate(sizes):
            changed = effect.apply(self.scene, size)
            if effect.stage is Stage.SENSOR:
                features = sensed(self.picture, changed, self.reference)
                moved = clean(features.vector() - self.sensed.vector())
                rows[number] = (
                    np.zeros_like(moved) if effect.white else moved,
                    clean(features.pixels - self.sensed.pixels),
                )
            elif changed == self.scene:
                rows[number] = (np.zeros(len(self.base)), still)
            elif effect.stage is Stage.CAMERA:
                rows[number] = (self.seen_by(changed), still)
            elif number not in plan:
                own = self.on_fine_cells if mended and number in few else look
                rows[number] = (own.change(self.fabric, changed), still)
        for number, (source, factor) in plan.items():
            if number not in rows:
                rows[number] = (factor * rows[source][0], still)
        if mended and look is self:
            self._mend(effect, rows)
        ordered = [rows[number] for number in range(len(sizes))]
        return {"vector": np.stack([r[0] for r in ordered]), "pixels": np.stack([r[1] for r in ordered])}

    def _mend(self, effect: Effect, rows: dict[int, tuple[Array, Array]]) -> None:
        """Add what the state's own cells do otherwise at half sizes: to the large ones as much, which coarse cells show
        better. Less probable places were simulated on them already.
        """
        larger: dict[int, list[int]] = {}
        for number, (half, _) in shortcuts(effect).items():
            if number not in aside(effect):
                larger.setdefault(half, []).append(number)
        for half, numbers in larger.items():
            changed = effect.apply(self.scene, nodes(effect)[half])
            otherwise = self.on_fine_cells.change(self.fabric, changed) - rows[half][0]
            for number in (half, *numbers):
                rows[number] = (rows[number][0] + otherwise, rows[number][1])

    @staticmethod
    def _shortcuts(effect: Effect) -> Mapping[int, tuple[int, float]]:
        mechanical = effect.stage in (Stage.FABRIC, Stage.SETUP, Stage.ENVIRONMENT)
        return shortcuts(effect) if mechanical else {}


def other_radius_m(setup: Setup, cell_m: float) -> float:
    """Of magnets that hold a point where the stated ones hold a patch on such cells, or a patch where a point [m]."""
    if setup.pin_radius_m > 0.5 * cell_m:
        return 0.0
    return PATCH_RADIUS_M if cell_m <= 0.01 else min(1.1 * cell_m, LARGEST_PATCH_M)


def smaller(scene: SimulationScene) -> SimulationScene:
    """The scene seen by half as many pixels each way, for pictures without noise; unchanged where that is not whole."""
    camera = scene.camera
    if camera.width % 2 or camera.height % 2 or camera.width < 400:
        return scene
    return replace(scene, camera=camera.scaled(0.5))


def _stepped(parameters: FabricParameters, index: int) -> tuple[FabricParameters, float]:
    """With one parameter changed, and by what share: up, or down where a fabric may not be larger."""
    values = parameters.as_array()
    most = LIMITS[PARAMETER_NAMES[index]][1]
    step = PARAMETER_STEP if values[index] * (1 + PARAMETER_STEP) <= most else -PARAMETER_STEP
    values[index] *= 1 + step
    return FabricParameters.from_array(values), step


def sensed(picture: NDArray[np.float32], scene: SimulationScene, reference: Reference) -> Features:
    """Features of a simulated picture with the sensor's noise, always the same noise."""
    noisy = scene.sensor.apply(picture, np.random.default_rng(0), camera=scene.camera)
    return measure(noisy, reference)


def clean(change: Array) -> Array:
    """A change with zeros where nothing can be said."""
    return np.where(np.isfinite(change), change, 0.0)
