"""What a fold state looks like when a parameter, a pin, an effect or a probe is changed: simulated and measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from diagnosis.effect import Effect, Stage
from diagnosis.measurement.features import Features, measure
from diagnosis.measurement.picture import depth_rms, picture_of
from diagnosis.measurement.reference import Reference, make_reference
from diagnosis.scene import SimulationScene
from diagnosis.simulation.probes import probed
from diagnosis.simulation.simulator import KeyedDrape, Simulator
from diagnosis.simulation.sizes import aside, nodes, shortcuts
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
class Variations:
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
    def on_fine_cells(self) -> Variations:
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
        changed = [stepped(self.fabric, k) for k in range(7)]
        parameters = [look.change(fabric, self.scene) / step for fabric, step in changed]
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
        if not np.isfinite(drape.drape.vertices).all():  # it diverged: nothing can be said
            return {"grip": np.zeros(len(self.base))}
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
            fine = self.on_fine_cells.change(self.fabric, changed)
            if not fine.any():  # it diverged there: coarse cells alone say something
                continue
            if not rows[half][0].any():  # it diverged on coarse cells: the state's own alone do
                rows[half] = (fine, rows[half][1])
                for number in numbers:
                    rows[number] = (shortcuts(effect)[number][1] * fine, rows[number][1])
                continue
            otherwise = fine - rows[half][0]
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


def stepped(parameters: FabricParameters, index: int) -> tuple[FabricParameters, float]:
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
