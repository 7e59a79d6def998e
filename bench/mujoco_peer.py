"""The same drapes by MuJoCo's flex, the best peer that was found: CPU seconds until the cloth stands still.

    python bench/mujoco_peer.py [--cells 10] [--fabrics medium] [--scenes hanging]

Saint Venant-Kirchhoff triangles and hinge bending, normalised to the stated rigidity; implicit ``discrete`` integrator
with steps of 0.1 s; at rest when no vertex is faster than 1 mm/s. MuJoCo's cloth is isotropic without a Poisson ratio:
it gets the geometric mean of warp and weft. Needs the extra ``bench`` (``pip install mujoco``).
"""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simcore.mesh import GridMesh
from simcore.parameters import FabricParameters
from simcore.scenes import Scene, Setup

STEP_S = 0.1
MOVE_S = 1.0
"""How long the pins take from the flat sheet to their places [s]."""
LIFT_M = 4e-3
REST_SPEED_M_S = 1e-3
CORNERS = {"top_left": (0, 0), "top_right": (0, -1), "bottom_right": (-1, -1)}


@dataclass(frozen=True)
class PeerDrape:
    """What the peer came to.

    Attributes:
        vertices: [m], panel frame, shape [V, 3].
        seconds: CPU seconds of the steps; ``set_up_seconds`` of building the model.
        steps: how many.
        speed_m_s: largest speed of a vertex at the end.
        at_rest: it fell below the limit.
    """

    vertices: NDArray[np.float64]
    seconds: float
    set_up_seconds: float
    steps: int
    speed_m_s: float
    at_rest: bool


def model_xml(fabric: FabricParameters, mesh: GridMesh, iterations: int, damping_s: float) -> str:
    """The scene: a grid of vertices with three sliding joints each, and the panel; weight is applied as a force."""
    stretch = math.sqrt(fabric.stretch_warp * fabric.stretch_weft)
    bending = math.sqrt(fabric.bending_warp * fabric.bending_weft)
    thickness = math.sqrt(12.0 * bending / stretch)
    width, height = mesh.size_m
    h = mesh.resolution_m
    return f"""<mujoco>
  <option timestep="{STEP_S}" gravity="0 0 0" integrator="discrete" solver="Newton" iterations="{iterations}"/>
  <size memory="2G"/>
  <worldbody>
    <geom type="plane" size="2 2 .1" condim="1"/>
    <flexcomp name="cloth" type="grid" dim="2" count="{mesh.columns} {mesh.rows} 1" spacing="{h} {h} {h}"
        mass="{fabric.density * width * height}" radius="0.0005" pos="0 {-0.5 * height} {LIFT_M}">
      <elasticity young="{stretch / thickness}" poisson="0" thickness="{thickness}" damping="{damping_s}"
          elastic2d="both"/>
      <contact condim="1" selfcollide="none"/>
    </flexcomp>
  </worldbody>
</mujoco>"""


def grid_order(mesh: GridMesh) -> NDArray[np.int64]:
    """MuJoCo's number of each of our vertices, [rows, columns]: along y first, from the lowest left corner."""
    return np.arange(mesh.vertex_count).reshape(mesh.columns, mesh.rows)[:, ::-1].T


def flat(mesh: GridMesh) -> NDArray[np.float64]:
    """The sheet before it is put up, shape [rows, columns, 3]."""
    u, v = mesh.material_coordinates.T
    x = np.stack([u - 0.5 * mesh.size_m[0], -v, np.full(u.shape, LIFT_M)], axis=1)
    return x.reshape(mesh.rows, mesh.columns, 3)


def drape(
    fabric: FabricParameters,
    setup: Setup,
    mesh: GridMesh,
    *,
    time_limit_s: float = 300.0,
    iterations: int | None = None,
    damping_s: float | None = None,
) -> PeerDrape:
    """Let the peer drape a sample by its corner points; ``time_limit_s`` in CPU seconds.

    By default 20 iterations a step and a damping of 0.1 s, on fine meshes 200 and 1 s.

    Pins are vertices a million times as heavy, moved by setting their places and velocities: exact, and no constraint.
    """
    import mujoco

    fine = mesh.columns > 60
    began = time.process_time()
    damping = damping_s if damping_s is not None else (1.0 if fine else 0.1)
    xml = model_xml(fabric, mesh, iterations or (200 if fine else 20), damping)
    model = mujoco.MjModel.from_xml_string(xml)
    order, rest = grid_order(mesh), flat(mesh)
    first = model.jnt_dofadr[model.body_jntadr[model.flex_vertbodyid]]  # each vertex has its three dofs in a row
    pins = [int(order[CORNERS[name]]) for name in setup.pins_m]
    bodies = model.flex_vertbodyid[pins]
    weight = np.zeros(model.nv)
    weight[first + 1] = -9.81 * model.body_mass[model.flex_vertbodyid]
    model.body_mass[bodies] *= 1e6
    data = mujoco.MjData(model)
    mujoco.mj_setConst(model, data)
    mujoco.mj_forward(model, data)
    assert np.allclose(np.asarray(data.flexvert_xpos)[order.ravel()], rest.reshape(-1, 3), atol=1e-9)
    data.qfrc_applied[:] = weight
    data.qvel[:] = 0.02 * np.random.default_rng(0).standard_normal(model.nv)
    starts = np.array([rest[CORNERS[name]] for name in setup.pins_m])
    moves = np.array(list(setup.pins_m.values())) - starts
    pin_dofs = first[pins][:, None] + np.arange(3)
    free_dofs = np.setdiff1d(np.arange(model.nv), pin_dofs)
    set_up = time.process_time() - began
    began, steps, speed = time.process_time(), 0, math.inf
    while time.process_time() - began < time_limit_s:
        before, after = (min(1.0, n * STEP_S / MOVE_S) for n in (steps, steps + 1))
        data.qpos[pin_dofs] = before * moves
        data.qvel[pin_dofs] = (after - before) * moves / STEP_S
        mujoco.mj_step(model, data)
        steps += 1
        speed = float(np.abs(data.qvel[free_dofs]).max())
        if not math.isfinite(speed) or (before == 1.0 and speed < REST_SPEED_M_S):
            break
    seconds = time.process_time() - began
    mujoco.mj_forward(model, data)
    vertices = np.asarray(data.flexvert_xpos)[order.ravel()].copy()
    return PeerDrape(vertices, seconds, set_up, steps, speed, speed < REST_SPEED_M_S)


def main() -> None:
    """Run the peer alone."""
    from fabrics import FABRICS

    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--cells", type=float, default=10.0, help="mm")
    parser.add_argument("--fabrics", nargs="+", default=["medium"], choices=list(FABRICS))
    parser.add_argument("--scenes", nargs="+", default=[s.value for s in Scene])
    parser.add_argument("--limit", type=float, default=300.0, help="CPU seconds a drape")
    parser.add_argument("--damping", type=float, default=None, help="s")
    parser.add_argument("--iterations", type=int, default=None, help="of the solver a step")
    options = parser.parse_args()
    mesh = GridMesh(1e-3 * options.cells)
    for name in options.fabrics:
        for scene in options.scenes:
            done = drape(
                FABRICS[name],
                Setup.nominal(scene),
                mesh,
                time_limit_s=options.limit,
                iterations=options.iterations,
                damping_s=options.damping,
            )
            sag = -done.vertices[:, 1].min()
            print(
                f"{name:8} {scene:8} {done.seconds:7.2f} s + {done.set_up_seconds:5.2f} s set-up, {done.steps} steps, "
                f"speed {done.speed_m_s:.1e} m/s, at rest: {done.at_rest}, lowest point {sag:.3f} m"
            )


if __name__ == "__main__":
    main()
