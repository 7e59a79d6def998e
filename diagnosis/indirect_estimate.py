"""A fabric's parameters from captures that show an effect: the network, asked about simulations that show it too.

The network knows cloth without effects, so what an effect does to a picture is in its estimates. Here simulated
captures with the effect on are taken to the same network, and the parameters are sought of which it says the same as of
the captures: indirect inference (Gouriéroux, Monfort and Renault 1993, Journal of Applied Econometrics 8, S85-S118),
by fixed-point steps in ln p.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture.capture_set import Capture, CaptureSet
from capture.normalise import NetworkInput, normalise_depth
from capture.prepare import PreparedCapture
from diagnosis.afresh.fresh import is_finite
from diagnosis.effects_in_poses import check_effects
from diagnosis.extension import SimulatorExtension
from diagnosis.measurement.picture import picture_of
from diagnosis.scene import SimulationScene
from diagnosis.simulation.simulator import Simulator
from diagnosis.tasks.capture_scene import capture_scene
from diagnosis.tasks.fabric_task import BASE_JITTER, BASE_SEEDS
from diagnosis.tasks.meshing import cell_size
from diagnosis.tasks.parameters import INTERVAL_90
from diagnosis.tasks.sensors import usual_distance
from simcore.errors import InputError, SimulationError
from simcore.mesh import GridMesh
from simcore.parameters import ESTIMATED_NAMES, LIMITS, FabricParameters
from simcore.scenes import Scene
from trainer.predict import Estimate, Estimator

Array = NDArray[np.float64]
STEPS = 3
"""More bring estimates hardly nearer to the cloths' own (measured, see docs/closing-the-loop.md)."""
LONGEST_STEP = 1.0
"""In ln p: what the network says of a simulation that is far off is not believed further than this."""
ROUNDING = 1e-6
"""In ln p: so far inside of what a fabric may have do estimates stay."""
UNSURE = 1.0
"""So many standard deviations, as shares of it, does what an estimate moved by add to its own: steps do not reach what
an effect hides."""


@dataclass(frozen=True)
class IndirectEstimate:
    """What captures tell of a fabric if they show effects.

    Attributes:
        estimate: with parameters and intervals as found with the effects on; the rest as the network says of the
            captures.
        first: as the network says of the captures, which knows of no effects.
        left: root mean square in ln p by which what the network says of simulations of the estimate differs still from
            what it says of the captures.
        simulations: that were asked for.
        unrested: of these, that did not come to rest; they count as far as they came.
    """

    estimate: Estimate
    first: Estimate
    left: float
    simulations: int
    unrested: int


class IndirectEstimator:
    """Estimates fabrics of one capture set with effects on.

    Args:
        captures: the set.
        prepared: all of its captures; their pictures are not kept.
        extension: the effects.
        estimator: the network.
        simulator: of drapes.
        resolution_m: wanted edge of a mesh cell.

    Attributes:
        in_poses: names of effects, as :func:`diagnosis.effects_in_poses.check_effects` tells them.

    Raises:
        InputError: captures that cannot be simulated, with the effects or without, or as :func:`check_effects`.
    """

    def __init__(
        self,
        captures: CaptureSet,
        prepared: Iterable[PreparedCapture],
        extension: SimulatorExtension,
        estimator: Estimator,
        simulator: Simulator,
        resolution_m: float = 0.01,
    ) -> None:
        self.in_poses = check_effects(captures, extension, resolution_m)
        self.estimator, self.simulator = estimator, simulator
        self._asked = self._unrested = 0
        self._inputs: dict[str, dict[Scene | str, list[NetworkInput]]] = {}
        beside = tuple(effect for effect in extension.effects if effect.name not in self.in_poses)
        posed: list[tuple[Capture, Array]] = []
        for one in prepared:
            seen = self._inputs.setdefault(one.capture.fabric.id, {})
            seen.setdefault(one.capture.scene, []).append(one.network_input)
            posed.append((one.capture, one.registration.camera_from_panel))
        usual_m = usual_distance(pose for _, pose in posed)
        self._shown: dict[str, list[_Shown]] = {}
        for capture, pose in posed:
            effects = beside if capture.camera_from_panel is None else extension.effects
            cell = cell_size(capture.setup.sample_size_m, resolution_m)
            scene = capture_scene(capture, pose, cell, usual_m)
            shown = _Shown(scene, extension.model_copy(update={"effects": effects}), cell)
            shown.with_effects(0)  # what cannot be applied is told now
            self._shown.setdefault(capture.fabric.id, []).append(shown)

    def estimate(
        self, fabric: str, density: float, on_step: Callable[[float], None] = lambda share: None
    ) -> IndirectEstimate:
        """Estimate one fabric.

        Args:
            fabric: its id.
            density: [kg/m²].
            on_step: told what share of it is done.

        Raises:
            InputError: as :meth:`trainer.predict.Estimator.estimate`; the message names the fabric.
            SimulationError: it cannot be simulated with the effects on.
        """
        first = self.estimator.estimate_named(fabric, self._inputs[fabric], density)
        said = _logs(first.parameters)
        low, high = np.log([LIMITS[name] for name in ESTIMATED_NAMES]).T + np.array([[ROUNDING], [-ROUNDING]])
        found, self._asked, self._unrested = said, 0, 0
        for step in range(STEPS):
            missing = said - self._says(fabric, density, found)
            on_step((step + 1) / (STEPS + 1))
            found = np.clip(found + np.clip(missing, -LONGEST_STEP, LONGEST_STEP), low, high)
        left = said - self._says(fabric, density, found)
        rms = float(np.sqrt(np.mean(left**2)))
        return IndirectEstimate(_moved(first, found, (low, high)), first, rms, self._asked, self._unrested)

    def _says(self, fabric: str, density: float, logs: Array) -> Array:
        """What the network says of simulated captures of a cloth, both in ln p, [6]."""
        six = dict(zip(ESTIMATED_NAMES, map(float, np.exp(logs)), strict=True))
        cloth = FabricParameters.from_mapping({**six, "density": density})
        seen: dict[Scene | str, list[NetworkInput]] = {}
        for scene in Scene:
            own = [shown for shown in self._shown[fabric] if shown.scene.setup.scene is scene]
            for number in range(BASE_SEEDS[scene.value] if own else 0):
                seen.setdefault(scene, []).append(self._capture(fabric, cloth, own[number % len(own)], number))
        try:
            return _logs(self.estimator.estimate(seen, density).parameters)
        except InputError as error:
            raise InputError(f"fabric {fabric!r} simulated with the effects on: {error}", code=error.code) from None

    def _capture(self, fabric: str, cloth: FabricParameters, shown: _Shown, number: int) -> NetworkInput:
        """A simulated capture as the network sees it, which takes it for one without effects."""
        stated, scene = shown.scene, shown.with_effects(number)
        mesh = GridMesh(shown.cell_m, scene.setup.sample_size_m)
        found = self.simulator.put_up(mesh, cloth, scene, seed=number, jitter=BASE_JITTER)
        drape = found.drape
        self._asked += 1
        self._unrested += not drape.ok
        if not is_finite(found):
            raise SimulationError(
                f"fabric {fabric!r} cannot be simulated in {scene.setup.scene.value} with the effects on "
                f"({drape.reason or drape.status.value}): check their sizes",
                code="effects_diverged",
            )
        depth = scene.sensor.apply(picture_of(drape, scene), np.random.default_rng(number), camera=scene.camera)
        try:
            return normalise_depth(depth, stated.camera, stated.camera_from_panel, stated.setup)
        except InputError as error:
            raise InputError(f"fabric {fabric!r} simulated with the effects on: {error}", code=error.code) from None


@dataclass(frozen=True)
class _Shown:
    """A capture as the simulator sees it: the scene without effects, those that it shows, and the cells' edge [m]."""

    scene: SimulationScene
    extension: SimulatorExtension
    cell_m: float

    def with_effects(self, number: int) -> SimulationScene:
        """The scene with the effects on, in a repeat of this number."""
        return self.extension.seeded(lambda _: float(number + 1)).apply(self.scene)


def _logs(parameters: Mapping[str, float]) -> Array:
    return np.log([parameters[name] for name in ESTIMATED_NAMES])


def _moved(first: Estimate, found: Array, bounds: tuple[Array, Array]) -> Estimate:
    """An estimate at other parameters, in ln p; its intervals move with it, and widen by what they move."""
    moved = found - _logs(first.parameters)
    intervals = {}
    for name, centre, by, low, high in zip(ESTIMATED_NAMES, found, moved, *bounds, strict=True):
        wide = INTERVAL_90 * UNSURE * by
        below, above = (math.hypot(math.log(end / first.parameters[name]), wide) for end in first.intervals_90[name])
        intervals[name] = (math.exp(max(centre - below, low)), math.exp(min(centre + above, high)))
    parameters = dict(zip(ESTIMATED_NAMES, map(float, np.exp(found)), strict=True))
    return replace(first, parameters=parameters, intervals_90=intervals)
