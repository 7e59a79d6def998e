"""Capture sets of MuJoCo's flex, diagnosed: does a cause keep its name where reality is another simulator's?

    python bench/mujoco_captures.py OUT [--sets none panel_tilt ...] [--fabrics 4] [--repeats 2] [--make-only]

Saint Venant-Kirchhoff triangles whose diagonals alternate (with diagonals of one direction MuJoCo's bending is three
times as stiff one way as the other), point pins, an own panel and jitter, no contact of the cloth with itself. Its
cloth is isotropic in the plane of the sheet: fabrics are stated so. Sets that differ by camera and sensor alone share
their drapes. A drape takes 10 to 90 CPU s, a set of drapes of its own five to ten minutes. Needs the extra ``bench``.
"""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from mujoco_peer import CORNERS, MOVE_S, flat
from numpy.typing import NDArray

from capture.capture_set import CAPTURES_FILE, CaptureSet
from diagnosis.diagnose import diagnose
from diagnosis.drape_cache import DrapeCache, drape_key
from diagnosis.effect import SCALAR, Effect, Size
from diagnosis.effects import get_effect
from diagnosis.scene import SimulationScene
from diagnosis.synthesis import Draper, SynthesisPlan, make_capture_set
from simcore.drape import Drape, DrapeStatus
from simcore.errors import InputError, SimulationError
from simcore.mechanics import Jitter, Mechanics
from simcore.mesh import GridMesh
from simcore.parameters import FabricParameters
from simcore.scenes import Setup

Array = NDArray[np.float64]
MESH = GridMesh(0.5 / 48)
FABRICS = ((500.0, 1.2e-4, 0.35), (300.0, 4e-5, 0.20), (900.0, 2e-4, 0.28), (400.0, 7e-5, 0.15))
"""Stretch [N/m], bending [N m] and density [kg/m²] of isotropic fabrics."""
JITTER = Jitter(0.0, 0.0004, 0.03)
STEP_S, MARK_STEPS = 0.02, 75
"""In steps of 0.1 s MuJoCo's contact lets a sheet sink 5 mm into the panel under its own weight."""
REST_M_S = 1e-4
"""At rest when no vertex is faster; with extrapolation in between, what is left is some tenths of a millimetre."""
LIMIT_S = 600.0
"""CPU seconds after which a drape that moves at up to twice that speed is taken as it is; a faster one is refused."""
BEHIND_M = 2e-3
"""MuJoCo's contact is soft (1.53 mm in a hanging drape of a tilted panel): what sinks by less than this is lifted."""
SETS: dict[str, tuple[tuple[str, Size], ...]] = {
    "none": (),
    "panel_tilt": (("panel_tilt", {SCALAR: 9.0}),),
    "air_draft": (("air_draft", {SCALAR: 0.3}),),
    "pin_spacing": (("pin_spacing", {SCALAR: 0.006}),),
    "pin_drop": (("pin_drop", {SCALAR: -0.008}),),
    "corner_pull": (("corner_pull", {SCALAR: 0.007}),),
    "hem_weight": (("hem_weight", {SCALAR: 25.0}),),
    "camera_rotation": (("camera_rotation", {"rx": -0.8, "ry": -0.4, "rz": 1.0}),),
    "camera_translation": (("camera_translation", {"tx": 0.002, "ty": -0.010, "tz": 0.001}),),
    "focal_scale": (("focal_scale", {SCALAR: -0.015}),),
    "depth_scale": (("depth_scale", {SCALAR: 0.015}),),
    "range_noise": (("range_noise", {SCALAR: 0.0025}),),
    "sensor_smoothing": (("sensor_smoothing", {SCALAR: 1.2}),),
    "edge_flying_pixels": (("edge_flying_pixels", {SCALAR: 0.5}),),
    "dropout": (("dropout", {SCALAR: 0.05}),),
    "quantisation": (("quantisation", {SCALAR: 0.003}),),
}


def sheet_xml(fabric: FabricParameters, mesh: GridMesh, elastic: str = "both") -> str:
    """The scene: triangles with alternating diagonals over the panel; weight is applied as a force.

    Args:
        fabric: the geometric means of its warp and weft count.
        mesh: the sheet's.
        elastic: ``both`` stretch and bending, or ``bend`` alone.
    """
    stretch = math.sqrt(fabric.stretch_warp * fabric.stretch_weft)
    thickness = math.sqrt(12.0 * math.sqrt(fabric.bending_warp * fabric.bending_weft) / stretch)
    corners = []
    for j in range(mesh.rows - 1):
        for i in range(mesh.columns - 1):
            a, c = j * mesh.columns + i, (j + 1) * mesh.columns + i
            one = (a, c, c + 1, a, c + 1, a + 1) if (i + j) % 2 == 0 else (a, c, a + 1, a + 1, c, c + 1)
            corners.append(" ".join(map(str, one)))
    points = " ".join(f"{value:.9g}" for value in flat(mesh).ravel())
    width, height = mesh.size_m
    return f"""<mujoco>
  <option timestep="{STEP_S}" gravity="0 0 0" integrator="discrete" solver="Newton" iterations="20"/>
  <size memory="2G"/>
  <worldbody>
    <geom type="plane" size="2 2 .1" condim="1"/>
    <flexcomp name="cloth" type="direct" dim="2" point="{points}" element="{" ".join(corners)}"
        mass="{fabric.density * width * height}" radius="0.0005">
      <elasticity young="{stretch / thickness}" poisson="0" thickness="{thickness}" damping="0.01"
          elastic2d="{elastic}"/>
      <contact condim="1" selfcollide="none"/>
    </flexcomp>
  </worldbody>
</mujoco>"""


def bending_energy(angle: float) -> float:
    """Of the sheet rolled up along a direction [rad] to half a metre's radius, by that of the stated bending."""
    import mujoco

    fabric, radius = FabricParameters(500.0, 500.0, 250.0, 1e-4, 1e-4, 1e-4, 0.2), 0.5
    model = mujoco.MjModel.from_xml_string(sheet_xml(fabric, MESH, "bend"))
    data = mujoco.MjData(model)
    dofs = model.jnt_dofadr[model.body_jntadr[model.flex_vertbodyid]][:, None] + np.arange(3)
    x = flat(MESH).reshape(-1, 3)
    along, across = (
        np.array([math.cos(angle), math.sin(angle), 0.0]),
        np.array([-math.sin(angle), math.cos(angle), 0.0]),
    )
    centred = x - x.mean(axis=0)
    turn = centred @ along / radius
    rolled = radius * np.outer(np.sin(turn), along) + np.outer(centred @ across, across)
    rolled[:, 2] = radius * (2.0 - np.cos(turn))
    data.qpos[dofs] = rolled - x
    mujoco.mj_forward(model, data)
    energy = -0.5 * float(np.sum(data.qfrc_passive[dofs] * rolled))  # quadratic, and nothing on a flat sheet
    return energy / (0.5 * fabric.bending_warp / radius**2 * MESH.size_m[0] * MESH.size_m[1])


@dataclass(frozen=True)
class Repeat:
    """One repeat's random differences: where the pins are [m], the height to start from [rows, columns], a seed."""

    places: Array
    lift: Array
    rng: np.random.Generator

    @classmethod
    def draw(cls, setup: Setup, words: tuple[int, ...]) -> Repeat:
        """Pins by fractions of a millimetre, a smooth bulge of some centimetres."""
        rng = np.random.default_rng(words)
        places = np.array(list(setup.pins_m.values()))
        places[:, :2] += JITTER.pin_m * rng.standard_normal((len(places), 2))
        u, v = (np.cos(np.pi * np.outer(np.arange(4), np.linspace(0, 1, n))) for n in (MESH.columns, MESH.rows))
        bulge = np.einsum("ab,aj,bi->ji", rng.standard_normal((4, 4)), v, u)
        return cls(places, JITTER.placement_m * (bulge - bulge.min()) / np.ptp(bulge), rng)


def masses(fabric: FabricParameters, mechanics: Mechanics) -> tuple[Array, Array]:
    """Of every vertex: mass [kg] and area [m²], [rows, columns]."""
    across, down = (np.r_[0.5, np.ones(n - 2), 0.5] * MESH.resolution_m for n in (MESH.columns, MESH.rows))
    area = np.outer(down, across)
    mass = fabric.density * area
    mass[-1] += mechanics.hem_kg_m * across
    return mass, area


def peer_drape(fabric: FabricParameters, scene: SimulationScene, words: tuple[int, ...]) -> Drape:
    """Let MuJoCo drape it.

    Raises:
        InputError: an effect that it does not have.
        SimulationError: it does not come to rest, or goes through the panel.
    """
    import mujoco

    mechanics = scene.mechanics
    known = replace(mechanics, gravity=Mechanics().gravity, air_pressure_pa=0.0, hem_kg_m=0.0)
    if known != Mechanics() or scene.setup.pin_radius_m > 0.0:
        raise InputError("MuJoCo's cloth has gravity, a draft, a hem and points that are held only", code="peer_effect")
    model = mujoco.MjModel.from_xml_string(sheet_xml(fabric, MESH))
    first = model.jnt_dofadr[model.body_jntadr[model.flex_vertbodyid]]  # each vertex has its three dofs in a row
    mass, area = masses(fabric, mechanics)
    force = np.outer(mass.ravel(), mechanics.gravity)
    force[:, 2] += mechanics.air_pressure_pa * area.ravel()
    corners = [CORNERS[name] for name in scene.setup.pins_m]
    held = np.arange(MESH.vertex_count).reshape(MESH.rows, MESH.columns)[tuple(np.transpose(corners))]
    repeat = Repeat.draw(scene.setup, words)
    model.body_mass[model.flex_vertbodyid] = mass.ravel()
    model.body_mass[model.flex_vertbodyid[held]] *= 1e6
    data = mujoco.MjData(model)
    mujoco.mj_setConst(model, data)
    dofs = first[:, None] + np.arange(3)
    pins, heights = dofs[held], dofs[:, 2]
    data.qfrc_applied[dofs] = force
    data.qpos[heights] = repeat.lift.ravel()
    data.qvel[:] = 0.05 * repeat.rng.standard_normal(model.nv)
    start, goal = data.qpos[pins].copy(), repeat.places - flat(MESH).reshape(-1, 3)[held]
    free = np.setdiff1d(np.arange(model.nv), pins)
    began, steps, speed, marks = time.process_time(), 0, math.inf, []
    while time.process_time() - began < LIMIT_S:
        before, after = (min(1.0, n * STEP_S / MOVE_S) for n in (steps, steps + 1))
        data.qpos[pins] = start + before * (goal - start)
        data.qvel[pins] = (after - before) * (goal - start) / STEP_S
        mujoco.mj_step(model, data)
        steps += 1
        speed = float(np.abs(data.qvel[free]).max())
        if not math.isfinite(speed) or (before == 1.0 and speed < REST_M_S):
            break
        if before == 1.0 and speed < 20 * REST_M_S and steps % MARK_STEPS == 0:
            marks.append(data.qpos.copy())
            if len(marks) == 3:
                jump = extrapolated(*marks)
                jump[pins] = 0.0
                jump[heights[data.qpos[heights] + jump[heights] < 6e-4]] = 0.0
                data.qpos[:] += jump
                data.qvel[:] = 0.0
                marks = []
    mujoco.mj_forward(model, data)
    x = np.array(data.flexvert_xpos)
    reason = f"fastest vertex {speed:.1e} m/s, least height {1e3 * x[:, 2].min():.2f} mm"
    if not speed < 2 * REST_M_S or x[:, 2].min() < -BEHIND_M:
        raise SimulationError(f"MuJoCo's drape {words} is of no use: {reason}", code="peer_not_still")
    x[:, 2] = np.maximum(x[:, 2], 0.0)
    return Drape(MESH, x, DrapeStatus.STILL, 0.0, 0.0, True, steps, time.process_time() - began, reason)


def extrapolated(first: Array, second: Array, third: Array) -> Array:
    """From ``third`` on to where a motion that dies out by one factor ends (Aitken), 4 mm at most."""
    earlier, later = second - first, third - second
    ratio = float(earlier @ later) / max(float(earlier @ earlier), 1e-30)
    if not 0.2 < ratio < 0.97:
        return np.zeros_like(later)
    jump = later * ratio / (1.0 - ratio)
    return np.asarray(jump * min(1.0, 4e-3 / max(float(np.abs(jump).max()), 1e-12)))


def kept(cache: DrapeCache) -> Draper:
    """The same, from the cache where it is there."""

    def drape(fabric: FabricParameters, scene: SimulationScene, words: tuple[int, ...]) -> Drape:
        key = drape_key(MESH, fabric, scene.setup, scene.mechanics, jitter=JITTER, start=f"mujoco {words}")
        known = cache.get(key, MESH)
        if known is None:
            known = peer_drape(fabric, scene, words)
            print(f"  {words}: {known.seconds:.0f} CPU s, {known.reason}", flush=True)
            cache.put(key, known)
        return known

    return drape


def make(out: Path, name: str, fabrics: int, repeats: int) -> CaptureSet:
    """Write one of :data:`SETS`, or read it where it is."""
    if (out / name / CAPTURES_FILE).exists():
        return CaptureSet.load(out / name)
    effects: list[tuple[Effect, Size]] = [(get_effect(effect), size) for effect, size in SETS[name]]
    plan = SynthesisPlan(fabrics=fabrics, repeats=repeats, pin_radius_m=0.0, resolution_m=MESH.resolution_m, seed=31)
    bias = bending_energy(math.pi / 4) / bending_energy(0.0)
    stated = {
        n: FabricParameters(k, k, 0.5 * k, b, b, bias * b, density)
        for n, (k, b, density) in enumerate(FABRICS[:fabrics])
    }
    cache = DrapeCache(out / "drapes")
    return make_capture_set(out / name, plan, effects, fabrics=stated, name=name, draper=kept(cache))


def main() -> None:
    """Make the sets, diagnose them, print what was answered."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--sets", nargs="+", default=list(SETS), choices=list(SETS))
    parser.add_argument("--fabrics", type=int, default=len(FABRICS), choices=range(1, len(FABRICS) + 1))
    parser.add_argument("--repeats", type=int, default=2)
    parser.add_argument("--make-only", action="store_true")
    options = parser.parse_args()
    for name in options.sets:
        captures = make(options.out, name, options.fabrics, options.repeats)
        if options.make_only:
            continue
        cause = diagnose(captures).report.cause
        first = sorted(cause.probabilities.items(), key=lambda item: -item[1])[:3]
        named = "; ".join(f"{e.name} {e.magnitude} {e.unit}, {e.interval_90}" for e in cause.effects)
        print(f"{name}: {', '.join(f'{n} {p:.2f}' for n, p in first)}; named: {named or 'nothing'}", flush=True)


if __name__ == "__main__":
    main()
