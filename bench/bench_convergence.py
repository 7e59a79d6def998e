"""Energy and shape of one drape on 20, 10 and 5 mm cells: do finer meshes give the same?

    python bench/bench_convergence.py [--fabrics vstiff stiff medium soft] [--cells 20 10 5] [--radius 60]
                                      [--square] [--seed 0] [--json convergence.json]

Pins stand where stated and hold patches of a radius that every mesh resolves: a point that pulls has no answer that is
independent of the mesh. With 60 mm the patches of all three meshes reach equally far along the edges (60 mm) and
towards the middle of the sample (56.6 mm); in between the finer ones are fuller (24, 26 and 26.5 cm²), and what pulls
at them is stiffer. With ``--square`` they are squares of that edge, which have one outline on every mesh.

Fabrics have several drapes at rest, and which one a mesh comes to is chance. So the finest mesh is draped from flat,
and the others are brought to rest from that drape's own vertices: all stand for the same folds, where a coarse mesh can
have them. What each mesh comes to from flat is printed beside it. Changes are from the finest mesh, as shares of its
elastic energy plus the size of gravity's (their sum alone may be near zero). Depth: rms difference from the finest mesh
at the vertices of the coarsest.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict, dataclass, replace

import numpy as np
from bench_solver import LIMIT_S
from fabrics import FABRICS
from numpy.typing import NDArray
from results import add_json_option

import simcore.solver
from simcore.drape import Drape
from simcore.grid import Grid
from simcore.mechanics import Jitter
from simcore.mesh import GridMesh
from simcore.parameters import FabricParameters
from simcore.placement import Pins
from simcore.scenes import GRAVITY_M_S2, Scene, Setup
from simcore.solver import Solver

JITTER = Jitter(pin_m=0.0)
"""Forces and lift of the seed, which are the same on any mesh; pins where stated."""


@dataclass(frozen=True)
class Line:
    """One fabric in one scene on one mesh.

    Attributes:
        cells_mm: edge of a cell [mm].
        energy_j, status: at rest, from the finest mesh's drape.
        elastic_j: the energy without gravity's part; the panel's is in it.
        off: energy less the finest mesh's, share of the latter's elastic energy plus the size of gravity's.
        depth_mm: rms difference of the depth from the finest mesh's drape [mm].
        flat_energy_j, flat_status, flat_depth_mm: the same of the drape from flat on this mesh.
        seconds: CPU seconds of both.
    """

    fabric: str
    scene: str
    cells_mm: float
    energy_j: float
    status: str
    elastic_j: float
    off: float
    depth_mm: float
    flat_energy_j: float
    flat_status: str
    flat_depth_mm: float
    seconds: float

    def __str__(self) -> str:
        return (
            f"{self.fabric:7} {self.scene:8} {self.cells_mm:4g} mm"
            f"  {1e3 * self.energy_j:9.3f} mJ (elastic {1e3 * self.elastic_j:8.3f}) {100 * self.off:+7.3f} %"
            f"  depth {self.depth_mm:6.2f} mm  {self.status}"
            f"   from flat {1e3 * self.flat_energy_j:9.3f} mJ  depth {self.flat_depth_mm:6.2f} mm  {self.flat_status}"
            f"   {self.seconds:.1f} s"
        )


class SquarePins(Pins):
    """Pins that hold squares, whose edge is the radius."""

    @classmethod
    def of(cls, grid: Grid, setup: Setup, moves: NDArray[np.float64]) -> Pins:
        """As :meth:`simcore.placement.Pins.of`."""
        wide = replace(setup, pin_radius_m=np.sqrt(2.0) * setup.pin_radius_m)
        pins = Pins.of(grid, wide, moves)
        out = np.abs(pins.offset).max(axis=2) > setup.pin_radius_m + 1e-9
        owner, offset = np.where(out, -1, pins.owner).astype(np.int32), np.where(out[..., None], 0.0, pins.offset)
        return cls((owner >= 0).astype(np.int32), owner, offset, pins.start, pins.places)


def grid(drape: Drape, skip: int) -> NDArray[np.float64]:
    """Every ``skip``-th vertex of each direction [m], shape [rows, columns, 3]."""
    return drape.vertices.reshape(drape.mesh.rows, drape.mesh.columns, 3)[::skip, ::skip]


def gravity_j(drape: Drape, density: float) -> float:
    """Gravity's part of the energy [J], from y = 0; ``density`` [kg/m²]."""
    areas = Grid(drape.mesh.rows, drape.mesh.columns, drape.mesh.resolution_m, drape.mesh.resolution_m).areas
    return GRAVITY_M_S2 * density * float(np.sum(areas * grid(drape, 1)[..., 1]))


def apart_mm(drape: Drape, other: Drape, coarsest_m: float) -> float:
    """Rms difference of z at the vertices of the coarsest mesh [mm]."""
    first, second = (grid(d, round(coarsest_m / d.mesh.resolution_m))[..., 2] for d in (drape, other))
    return 1e3 * float(np.sqrt(np.mean((first - second) ** 2)))


def refined(solvers: list[Solver], name: str, scene: Scene, radius_m: float, seed: int) -> list[Line]:
    """One fabric in one scene on every mesh, coarsest first."""
    fabric: FabricParameters = FABRICS[name]
    setup = Setup.nominal(scene, pin_radius_m=radius_m)
    flat = [s.solve(fabric, setup, seed=seed, jitter=JITTER, time_limit_s=LIMIT_S) for s in solvers]
    finest, coarsest_m = flat[-1], flat[0].mesh.resolution_m
    pull = gravity_j(finest, fabric.density)
    scale = finest.energy - pull + abs(pull)
    lines = []
    for solver, own in zip(solvers, flat, strict=True):
        drape, seconds = own, own.seconds
        if own is not finest:
            skip = round(solver.mesh.resolution_m / finest.mesh.resolution_m)
            start = replace(own, vertices=np.ascontiguousarray(grid(finest, skip)).reshape(-1, 3))
            drape = solver.solve(fabric, setup, seed=seed, jitter=JITTER, start=start, time_limit_s=LIMIT_S)
            seconds += drape.seconds
        lines.append(
            Line(
                name,
                scene.value,
                1e3 * solver.mesh.resolution_m,
                drape.energy,
                drape.status.value,
                drape.energy - gravity_j(drape, fabric.density),
                (drape.energy - finest.energy) / scale,
                apart_mm(drape, finest, coarsest_m),
                own.energy,
                own.status.value,
                apart_mm(own, finest, coarsest_m),
                seconds,
            )
        )
    return lines


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--fabrics", nargs="+", default=list(FABRICS), choices=list(FABRICS))
    parser.add_argument("--scenes", nargs="+", default=[s.value for s in Scene], choices=[s.value for s in Scene])
    parser.add_argument("--cells", type=float, nargs="+", default=[20.0, 10.0, 5.0], help="mm, each part of the next")
    parser.add_argument("--radius", type=float, default=60.0, help="of the held patches, mm")
    parser.add_argument("--square", action="store_true", help="hold squares of that edge")
    parser.add_argument("--seed", type=int, default=0)
    add_json_option(parser, "convergence")
    options = parser.parse_args()
    if options.square:
        simcore.solver.Pins = SquarePins  # type: ignore[misc]  # the experiment's, not the product's
    solvers = [Solver(GridMesh(1e-3 * cells)) for cells in sorted(options.cells, reverse=True)]
    rows: list[Line] = []
    for name in options.fabrics:
        for scene in options.scenes:
            found = refined(solvers, name, Scene.parse(scene), 1e-3 * options.radius, options.seed)
            print(*found, sep="\n", flush=True)
            rows += found
    options.json.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
