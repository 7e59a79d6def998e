"""Capture sets made by simulation: for tests, the demonstration and the blind check."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.capture_set import CaptureSet, new_document
from diagnosis.effect import Effect, Size
from diagnosis.measurement.picture import picture_of
from diagnosis.scene import SimulationScene, pose_rows
from diagnosis.simulation.drape_cache import DrapeCache, drape_key
from renderer.camera import Camera, frontal_pose
from renderer.depth_png import write_depth_png
from renderer.sensor import SensorModel
from simcore.drape import Drape
from simcore.errors import SimulationError
from simcore.mechanics import Jitter
from simcore.mesh import GridMesh
from simcore.parameters import ESTIMATED_NAMES, FabricParameters
from simcore.prior import FabricPrior, is_admissible
from simcore.scenes import Scene, Setup
from simcore.solver import Solver

Pictures = Callable[[FabricParameters, SimulationScene, tuple[int, ...]], NDArray[np.float32]]

SET_CAMERA = Camera(640, 480, 475.0, 475.0, 319.5, 239.5)
SET_SENSOR = SensorModel(range_noise_m=0.001, at_m=0.9, quantisation_m=0.0002)
ATTEMPTS = 4
MISSTATED_ATTEMPTS = 100
SCENE_NUMBERS = {"hanging": 0, "stretch": 1}
NO_CACHE = DrapeCache(None)
DIAGNOSABLE = {
    "stretch_warp": (50.0, 2000.0),
    "stretch_weft": (50.0, 2000.0),
    "stretch_bias": (20.0, 500.0),
    "bending_warp": (5e-6, 4e-4),
    "bending_weft": (5e-6, 4e-4),
    "bending_bias": (5e-6, 4e-4),
    "density": (0.08, 0.45),
}
"""Fabrics that a 10 mm mesh resolves and a depth camera sees."""


@dataclass(frozen=True)
class SynthesisPlan:
    """What a synthetic capture set holds.

    Attributes:
        fabrics: number of fabrics, drawn from the prior.
        scenes: names.
        repeats: captures a fabric and scene.
        first_repeat: number of the first; others of one seed are further captures of the same samples.
        resolution_m: of the mesh.
        parameters_cv, density_cv: how far the stated parameters are off the simulated ones (log-normal).
        pin_radius_m: of the magnets.
        jitter: between repeats.
        seed: of everything.
        wrong: one fabric's parameter stated wrongly by a factor, (name, factor), or None.
    """

    fabrics: int = 4
    scenes: tuple[str, ...] = ("hanging", "stretch")
    repeats: int = 2
    first_repeat: int = 0
    resolution_m: float = 0.01
    parameters_cv: float = 0.07
    density_cv: float = 0.02
    pin_radius_m: float = 0.01
    jitter: Jitter = Jitter(1.0, 0.0003, 0.02)
    seed: int = 0
    wrong: tuple[str, float] | None = None


def draw_fabrics(count: int, seed: int) -> list[FabricParameters]:
    """Fabrics of the prior that can be diagnosed, the same for the same seed."""
    return FabricPrior.default(DIAGNOSABLE).sample(range(count), seed)


def misstate(
    fabric: FabricParameters, parameters_cv: float, density_cv: float, rng: np.random.Generator
) -> FabricParameters:
    """Parameters as somebody measured them: each off by a log-normal error.

    Raises:
        SimulationError: whatever the errors, such a cloth would not be stable.
    """
    sigma = np.array([parameters_cv] * 6 + [density_cv])
    for _ in range(MISSTATED_ATTEMPTS):
        values = fabric.as_array() * np.exp(sigma * rng.standard_normal(7))
        if is_admissible(values[None])[0]:
            return FabricParameters.from_array(values)
    raise SimulationError(
        f"none of {MISSTATED_ATTEMPTS} fabrics about as stated is stable: state a larger bending_bias beside "
        "bending_warp and bending_weft",
        code="fabric_not_stable",
    )


def real_fabric(plan: SynthesisPlan, number: int, stated: FabricParameters, *, first: bool) -> FabricParameters:
    """What is simulated where this is stated; the ``first`` fabric may have a parameter that is plainly wrong."""
    rng = np.random.default_rng([plan.seed, number, 1])
    real = misstate(stated, plan.parameters_cv, plan.density_cv, rng)
    if plan.wrong is None or not first:
        return real
    name, factor = plan.wrong
    return FabricParameters.from_mapping({**real.as_dict(), name: getattr(real, name) * factor})


def make_capture_set(
    folder: Path,
    plan: SynthesisPlan,
    effects: Sequence[tuple[Effect, Size]] = (),
    *,
    fabrics: Mapping[int, FabricParameters] | None = None,
    name: str = "synthetic",
    cache: DrapeCache = NO_CACHE,
    pictures: Pictures | None = None,
) -> CaptureSet:
    """Simulate a capture set and write it.

    Args:
        folder: where to; made if absent.
        plan: what it holds.
        effects: switched on in all captures, each with its size.
        fabrics: stated fabrics by number (which goes into their seeds); drawn from the prior by default. What is
            simulated is off by the plan's errors.
        name: of the set.
        cache: drapes that other sets of the same seed may share.
        pictures: another simulator: the ideal depth [m], [H, W], of a fabric in a scene, from a capture's seed words.

    Raises:
        SimulationError: a drape does not come to rest in several attempts.
    """
    folder.mkdir(parents=True, exist_ok=True)
    stated = dict(fabrics) if fabrics is not None else dict(enumerate(draw_fabrics(plan.fabrics, plan.seed)))
    take = pictures or _Shelf(Solver(GridMesh(plan.resolution_m)), plan.jitter, cache).picture
    entries: list[dict[str, Any]] = []
    for place, (number, fabric) in enumerate(stated.items()):
        real = real_fabric(plan, number, fabric, first=place == 0)
        for scene_name in plan.scenes:
            for repeat in range(plan.first_repeat, plan.first_repeat + plan.repeats):
                capture_id = f"f{place + 1}-{scene_name}-{repeat}"
                words = (plan.seed, number, SCENE_NUMBERS[scene_name], repeat)
                scene = build_scene(scene_name, plan, [(e, _of_repeat(e, size, words)) for e, size in effects])
                ideal = take(real, scene, words)
                noise = np.random.default_rng(np.random.SeedSequence((*words, 7, len(name), *name.encode())))
                depth = scene.sensor.apply(ideal, noise, camera=scene.camera)
                write_depth_png(folder / f"{capture_id}.png", depth, SET_CAMERA.depth_unit_m)
                entries.append(
                    {
                        "id": capture_id,
                        "fabric": f"f{place + 1}",
                        "scene": scene_name,
                        "repeat": repeat,
                        "depth": f"{capture_id}.png",
                    }
                )
    return _write(folder, plan, list(stated.values()), entries, name)


def _of_repeat(effect: Effect, size: Size, words: tuple[int, ...]) -> Size:
    """An effect that differs from repeat to repeat gets a seed of the repeat's own."""
    if not effect.random_repeats:
        return size
    return {**size, "seed": float(np.random.default_rng([*words, 11]).integers(1000, 1_000_000))}


def build_scene(scene_name: str, plan: SynthesisPlan, effects: Sequence[tuple[Effect, Size]] = ()) -> SimulationScene:
    """The nominal scene of a synthetic capture with effects on."""
    setup = Setup.nominal(Scene.parse(scene_name), pin_radius_m=plan.pin_radius_m)
    scene = SimulationScene(setup, camera=SET_CAMERA, pose=pose_rows(frontal_pose()), sensor=SET_SENSOR)
    for effect, size in effects:
        scene = effect.apply(scene, size)
    return scene


@dataclass(frozen=True)
class _Shelf:
    """Drapes solved once."""

    solver: Solver
    jitter: Jitter
    cache: DrapeCache

    def picture(self, fabric: FabricParameters, scene: SimulationScene, words: tuple[int, ...]) -> NDArray[np.float32]:
        """The ideal depth picture [m]."""
        return picture_of(self.drape(fabric, scene, words), scene)

    def drape(self, fabric: FabricParameters, scene: SimulationScene, words: tuple[int, ...]) -> Drape:
        """The first attempt that comes to rest.

        Raises:
            SimulationError: none does.
        """
        mesh = self.solver.mesh
        key = drape_key(mesh, fabric, scene.setup, scene.mechanics, jitter=self.jitter, start=f"capture {words}")
        kept = self.cache.get(key, mesh)
        if kept is not None:
            return kept
        for attempt in np.random.SeedSequence(words).spawn(ATTEMPTS):
            drape = self.solver.solve(
                fabric, scene.setup, seed=attempt, jitter=self.jitter, mechanics=scene.mechanics, time_limit_s=60.0
            )
            if drape.ok:
                self.cache.put(key, drape)
                return drape
        raise SimulationError(
            f"a synthetic capture did not come to rest in {ATTEMPTS} attempts ({drape.reason}): choose other fabrics",
            code="capture_not_still",
        )


def _write(
    folder: Path,
    plan: SynthesisPlan,
    stated: Sequence[FabricParameters],
    entries: list[dict[str, Any]],
    name: str,
) -> CaptureSet:
    fabrics: list[dict[str, Any]] = [
        {
            "id": f"f{number + 1}",
            "density": fabric.density,
            "parameters": {key: getattr(fabric, key) for key in ESTIMATED_NAMES},
            "parameters_cv": plan.parameters_cv,
            "density_cv": plan.density_cv,
        }
        for number, fabric in enumerate(stated)
    ]
    pins: Mapping[str, Any] = {scene: Setup.nominal(scene).pins_m for scene in plan.scenes}
    document = new_document(
        name=name,
        camera=SET_CAMERA,
        fabrics=fabrics,
        captures=entries,
        setup={
            "sample_size_m": [0.5, 0.5],
            "camera_from_panel": frontal_pose().tolist(),
            "pins_m": pins,
            "panel": True,
            "pin_radius_m": plan.pin_radius_m,
        },
        sensor={
            "range_noise_m": SET_SENSOR.range_noise_m,
            "at_m": SET_SENSOR.at_m,
            "quantisation_m": SET_SENSOR.quantisation_m,
        },
    )
    made = CaptureSet(folder, document)
    made.save()
    return made
