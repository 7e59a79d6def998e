"""Another simulator of cloth, to hold the diagnosis against: nothing of the solver's physics or of its way to rest.

Irregular triangles of constant strain, plates that feel curvature by the angles at their sides, magnets that hold a
point, a panel that pushes back like a spring, dynamics with damping until nothing moves. Slow and plain; for ``bench``
alone. What it takes over are the meaning of the parameters (``docs/conventions.md``) and the sparse factorisation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from triangle_mesh import Array, Ints, Mesh

from diagnosis.scene import SimulationScene
from simcore.mechanics import Mechanics, UniformCurvature
from simcore.parameters import FabricParameters
from simcore.pardiso import Factorisation

STEP_S = 0.04
STEPS = 60
SETTLING = 400
"""Most steps after the pins are home; the time step grows while the energy falls."""
REST = 2e-3
"""Root mean square force out of balance, in weights of a vertex, at which the cloth counts as still."""
CONTACT_M = 5e-4
"""Below this height the panel pushes back."""
SINK_M = 1e-6
"""How far a vertex pressed by its own weight sinks below that."""


@dataclass(frozen=True)
class Patches:
    """Triangles with a hinge on each of their three sides, and the few hinges that belong to none.

    Attributes:
        hinges: numbers of each triangle's hinges, [patches, 3].
        lone: numbers of the hinges of no such triangle, at the rim, [lone].
        areas, lone_areas: what each stands for [m2]: a triangle at the rim goes to its hinges' in equal parts.
        vertices: of each triangle and of each lone hinge, six, some twice, [patches + lone, 6].
        slots: where among them the vertices of its hinges stand, [patches + lone, 3, 4].
    """

    hinges: Ints
    lone: Ints
    areas: Array
    lone_areas: Array
    vertices: Ints
    slots: Ints

    @classmethod
    def of(cls, mesh: Mesh, area: Array) -> Patches:
        """The patches of a mesh with these areas of its triangles."""
        place = {(min(a, b), max(a, b)): k for k, (a, b, _, _) in enumerate(mesh.edges.tolist())}
        sides = [
            [place[key] for key in ((min(p), max(p)) for p in ((a, b), (b, c), (c, a))) if key in place]
            for a, b, c in mesh.triangles.tolist()
        ]
        whole = [k for k, own in enumerate(sides) if len(own) == 3]
        hinges = np.array([sides[k] for k in whole])
        lone = np.setdiff1d(np.arange(len(mesh.edges)), hinges)
        owner = {h: k for k, own in enumerate([*hinges.tolist(), *([h] for h in lone.tolist())]) for h in own}
        areas = np.concatenate([area[whole], np.zeros(len(lone))])
        for own, size in zip(sides, area, strict=True):
            for h in own if len(own) < 3 else ():
                areas[owner[h]] += size / len(own)
        vertices, slots = [], []
        for own in [*hinges.tolist(), *([h] * 3 for h in lone.tolist())]:
            fours = mesh.edges[own].tolist()
            six = list(dict.fromkeys(k for four in fours for k in four))
            vertices.append((six + six)[:6])
            slots.append([[six.index(k) for k in four] for four in fours])
        count = len(hinges)
        return cls(hinges, lone, areas[:count], areas[count:], np.array(vertices), np.array(slots))


def _rigidity(fabric: FabricParameters) -> Array:
    """Of a plate, [3, 3] [N m]: moments along weft, along warp and of twist per curvature.

    A cylinder cannot tell Poisson's effect from twist: shared as hinges of all directions would, where that is stable.
    """
    weft, warp = fabric.bending_weft, fabric.bending_warp
    mixed = 4.0 * fabric.bending_bias - weft - warp
    across = min(mixed / 6.0, 0.9 * math.sqrt(weft * warp)) if mixed > 0 else 0.5 * mixed
    return np.array([[weft, across, 0.0], [across, warp, 0.0], [0.0, 0.0, mixed - 2.0 * across]])


class HingeCloth:
    """One fabric in one scene.

    Raises:
        ValueError: the scene has physics that this simulator lacks.
    """

    def __init__(self, mesh: Mesh, fabric: FabricParameters, scene: SimulationScene, seed: int) -> None:
        mechanics = scene.mechanics
        lacking = [k for k in ("adhesion_pa", "friction") if getattr(mechanics, k)]
        if lacking:
            raise ValueError(f"this simulator has no {lacking[0]}")
        self.mesh, self.scene, self.rng = mesh, scene, np.random.default_rng(seed)
        self.count = len(mesh.uv)
        self._membrane(fabric, mechanics)
        self._bending(fabric, mechanics)
        self._loads(fabric, mechanics)
        self._pins()
        self._pattern()

    def _membrane(self, fabric: FabricParameters, mechanics: Mechanics) -> None:
        """Area and gradients of the shape functions along weft and warp, [triangles, 3, 2]."""
        turn = mechanics.off_grain_rad
        uv = self.mesh.uv @ np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
        p = uv[self.mesh.triangles]
        edges = np.stack([p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]], axis=2)
        self.area = 0.5 * np.abs(np.linalg.det(edges))
        back = np.linalg.inv(edges)
        self.shape = np.concatenate([-back.sum(axis=1, keepdims=True), back], axis=1)
        self.stretch = np.array([fabric.stretch_weft, fabric.stretch_warp, fabric.stretch_bias])
        self.stiffening = mechanics.stiffening_strain

    def _bending(self, fabric: FabricParameters, mechanics: Mechanics) -> None:
        """A triangle's curvature is what its three hinges say together, its energy that of an orthotropic plate (in the
        way of Grinspun et al. 2006, "Computing discrete shape operators on general meshes").

        Angles off their rest, at ``hinges`` [elements, 3], times ``plate`` [elements, 3, 3] are moments [N m]. A sheet
        bent to a cylinder along any direction is as stiff as stated, whatever the mesh. (Stiffnesses of single hinges
        cannot be: edges of three directions know nothing that goes round four times, as bias against warp and weft.)
        """
        turn = mechanics.off_grain_rad
        u, v = (self.mesh.uv @ np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])).T
        # angles per curvature along weft, along warp and of twist, [hinges, 3]
        unit = np.stack([self._flat_angles(height) for height in (0.5 * u**2, 0.5 * v**2, u * v)], axis=1)
        rigid = _rigidity(fabric)
        patches = Patches.of(self.mesh, self.area)
        back = np.linalg.inv(unit[patches.hinges])
        plate = patches.areas[:, None, None] * (back.transpose(0, 2, 1) @ rigid @ back)
        # a lone hinge bends as a cylinder does whose axis it is
        ends = self.mesh.edges[patches.lone][:, :2]
        du, dv = u[ends[:, 1]] - u[ends[:, 0]], v[ends[:, 1]] - v[ends[:, 0]]
        bent = np.stack([dv**2, du**2, -du * dv], axis=1) / (du**2 + dv**2)[:, None]
        lone = np.zeros((len(bent), 3, 3))
        felt = np.einsum("hi,ij,hj->h", bent, rigid, bent)
        lone[:, 0, 0] = patches.lone_areas * felt / (unit[patches.lone] * bent).sum(axis=1) ** 2
        self.plate = np.concatenate([plate, lone])
        self.hinges = np.concatenate([patches.hinges, np.repeat(patches.lone[:, None], 3, axis=1)])
        self.patches, self.slots = patches.vertices, patches.slots
        self.rest_angle = np.zeros(len(self.mesh.edges))
        for field in mechanics.rest_curvature:
            if not isinstance(field, UniformCurvature):
                raise ValueError(f"this simulator has no {type(field).__name__}")
            u, v = self.mesh.uv.T
            self.rest_angle += self._flat_angles(0.5 * (field.weft * u**2 + field.warp * v**2))

    def _flat_angles(self, height: Array) -> Array:
        """Angles of the flat sheet per height [m] given to its vertices, [hinges]."""
        uv, little = self.mesh.uv, 1e-6
        return self._angles(np.stack([uv[:, 0], -uv[:, 1], little * height], axis=1))[0] / little

    def _loads(self, fabric: FabricParameters, mechanics: Mechanics) -> None:
        """Mass, and force on every vertex."""
        uv, triangles = self.mesh.uv, self.mesh.triangles
        share = np.repeat(self.area / 3.0, 3)
        areas = np.bincount(triangles.ravel(), share, minlength=self.count)
        hem = np.zeros(self.count)
        low = np.flatnonzero(uv[:, 1] > uv[:, 1].max() - 1e-9)
        low = low[np.argsort(uv[low, 0])]
        gaps = np.diff(uv[low, 0])
        hem[low[:-1]] += 0.5 * gaps
        hem[low[1:]] += 0.5 * gaps
        self.mass = fabric.density * areas + mechanics.hem_kg_m * hem
        self.force = self.mass[:, None] * np.array(mechanics.gravity)
        self.force[:, 2] += mechanics.air_pressure_pa * areas
        self.weight = 9.81 * fabric.density * float(np.median(areas))
        self.contact = 9.81 * fabric.density * areas / SINK_M if self.scene.setup.panel else np.zeros(self.count)

    def _pins(self) -> None:
        """The corner vertices, where they start (flat) and where they go."""
        uv = self.mesh.uv
        corners = {"top_left": (0, 0), "top_right": (1, 0), "bottom_left": (0, 1), "bottom_right": (1, 1)}
        size = uv.max(axis=0)
        pins = self.scene.setup.pins_m
        self.held = np.array([int(np.argmin(np.abs(uv - size * corners[name]).sum(axis=1))) for name in pins])
        moves = np.zeros((len(pins), 3))
        moves[:, :2] = 3e-4 * self.rng.standard_normal((len(pins), 2))
        self.home = np.array([pins[name] for name in pins], dtype=np.float64) + moves
        self.home[:, 2] += CONTACT_M
        self.free = np.ones(self.count, dtype=bool)
        self.free[self.held] = False

    def _pattern(self) -> None:
        """Where each number of the elements' Hessians goes in the upper triangle of the whole."""
        rows, columns = [], []
        for ids in (self.mesh.triangles, self.patches):
            dofs = (3 * ids[:, :, None] + np.arange(3)).reshape(len(ids), -1)
            rows.append(np.repeat(dofs, dofs.shape[1], axis=1).ravel())
            columns.append(np.tile(dofs, (1, dofs.shape[1])).ravel())
        everyone = np.arange(3 * self.count)
        row, column = np.concatenate([*rows, everyone]), np.concatenate([*columns, everyone])
        self.upper = np.flatnonzero(row <= column)
        code = row[self.upper] * (3 * self.count) + column[self.upper]
        kept, self.slot = np.unique(code, return_inverse=True)
        self.row, self.column = kept // (3 * self.count), kept % (3 * self.count)
        matrix = sp.csr_array((np.ones(len(kept)), (self.row, self.column)))
        self.factorisation = Factorisation(matrix.indptr.astype(np.int32), matrix.indices.astype(np.int32))
        held = np.repeat(~self.free, 3)
        self.blocked = (held[self.row] | held[self.column]) & (self.row != self.column)
        self.diagonal = np.flatnonzero(self.row == self.column)

    def forces(self, x: Array, hessian: bool = False) -> tuple[float, Array, Array | None]:
        """Energy [J], its gradient [N], [vertices, 3], and (positive) Hessian's values in the pattern's order."""
        energy, gradient, parts = 0.0, np.zeros_like(x), []
        for element in (self._stretched, self._bent):
            e, g, h, ids = element(x, hessian)
            energy += e
            for k in range(3):
                gradient[:, k] += np.bincount(ids.ravel(), g[:, :, k].ravel(), minlength=self.count)
            if h is not None:
                parts.append(h.ravel())
        deep = np.maximum(CONTACT_M - x[:, 2], 0.0)
        energy += 0.5 * float(self.contact @ deep**2) - float((self.force * x).sum())
        gradient -= self.force
        gradient[:, 2] -= self.contact * deep
        if not hessian:
            return energy, gradient, None
        spring = np.zeros_like(x)
        spring[:, 2] = np.where(deep > 0, self.contact, 0.0)
        whole = np.concatenate([*parts, spring.ravel()])[self.upper]
        values: Array = np.asarray(np.bincount(self.slot, whole), dtype=np.float64)
        return energy, gradient, values

    def _stretched(self, x: Array, hessian: bool) -> tuple[float, Array, Array | None, Ints]:
        """Orthotropic St Venant-Kirchhoff membrane; its Hessian with the compressive part of the stress left out."""
        ids = self.mesh.triangles
        tangent = np.einsum("tvc,tva->tac", x[ids], self.shape)
        a, b = tangent[:, 0], tangent[:, 1]
        strain = np.stack([0.5 * ((a * a).sum(1) - 1), 0.5 * ((b * b).sum(1) - 1), (a * b).sum(1)], axis=1)
        stress, modulus = self.stretch * strain, np.broadcast_to(self.stretch, strain.shape)
        energy = 0.5 * self.stretch * strain**2
        if self.stiffening is not None:
            pulled = np.maximum(strain[:, :2], 0.0)
            extra = np.zeros_like(strain)
            extra[:, :2] = self.stretch[:2] / (3.0 * self.stiffening**2)
            stress = stress + extra * np.pad(pulled**3, ((0, 0), (0, 1)))
            modulus = modulus + 3.0 * extra * np.pad(pulled**2, ((0, 0), (0, 1)))
            energy = energy + 0.25 * extra * np.pad(pulled**4, ((0, 0), (0, 1)))
        su, sv = self.shape[:, :, :1], self.shape[:, :, 1:]
        rates = np.stack([su * a[:, None], sv * b[:, None], su * b[:, None] + sv * a[:, None]], axis=1)  # [t, 3, v, c]
        gradient = np.einsum("t,ts,tsvc->tvc", self.area, stress, rates)
        total = float((self.area[:, None] * energy).sum())
        if not hessian:
            return total, gradient, None, ids
        flat = rates.reshape(len(ids), 3, 9)
        h = np.einsum("ts,tsi,tsj->tij", self.area[:, None] * modulus, flat, flat, optimize=True)
        tensor = np.stack([stress[:, 0], stress[:, 2], stress[:, 2], stress[:, 1]], axis=1).reshape(-1, 2, 2)
        value, vector = np.linalg.eigh(tensor)
        tensor = np.einsum("tij,tj,tkj->tik", vector, np.maximum(value, 0.0), vector)
        geometric = np.einsum("t,tva,tab,twb->tvw", self.area, self.shape, tensor, self.shape, optimize=True)
        h += np.einsum("tvw,cd->tvcwd", geometric, np.eye(3)).reshape(len(ids), 9, 9)
        return total, gradient, h, ids

    def _bent(self, x: Array, hessian: bool) -> tuple[float, Array, Array | None, Ints]:
        """Triangles' curvatures from hinges; angle and its gradient after Bridson et al. 2003; Gauss and Newton's
        Hessian, of patches."""
        ids = self.mesh.edges
        angle, rate = self._angles(x)
        off = (angle - self.rest_angle)[self.hinges]
        moment = np.einsum("tij,tj->ti", self.plate, off)
        total = 0.5 * float((moment * off).sum())
        felt = np.bincount(self.hinges.ravel(), moment.ravel(), minlength=len(ids))
        gradient = felt[:, None, None] * rate
        if not hessian:
            return total, gradient, None, ids
        spread = np.zeros((*self.hinges.shape, 6, 3))
        np.put_along_axis(spread, self.slots[..., None], rate[self.hinges], axis=2)
        flat = spread.reshape(len(spread), 3, 18)
        return total, gradient, flat.transpose(0, 2, 1) @ (self.plate @ flat), ids

    def _angles(self, x: Array) -> tuple[Array, Array]:
        """Angle of every hinge [rad], positive where the sheet's sides bend to the camera, and its gradient
        [hinges, 4, 3]."""
        ids = self.mesh.edges
        p, q, first, second = (x[ids[:, k]] for k in range(4))
        along = q - p
        length = np.linalg.norm(along, axis=1)
        n1, n2 = np.cross(p - first, q - first), np.cross(q - second, p - second)
        s1, s2 = (n1 * n1).sum(1), (n2 * n2).sum(1)
        sine = -(np.cross(n1, n2) * along).sum(1) / length
        angle = np.arctan2(sine, (n1 * n2).sum(1))
        d1, d2 = n1 * (length / s1)[:, None], n2 * (length / s2)[:, None]
        f1, f2 = n1 * ((1 / s1) / length)[:, None], n2 * ((1 / s2) / length)[:, None]
        at_p = ((first - q) * along).sum(1)[:, None] * f1 + ((second - q) * along).sum(1)[:, None] * f2
        at_q = -((first - p) * along).sum(1)[:, None] * f1 - ((second - p) * along).sum(1)[:, None] * f2
        return angle, np.stack([at_p, at_q, d1, d2], axis=1)

    def drape(self) -> tuple[Array, float]:
        """Put up and left alone until it is still.

        Returns:
            Positions in the panel frame [vertices, 3] and what is left out of balance [vertex weights].
        """
        uv = self.mesh.uv
        size = uv.max(axis=0)
        x = np.stack([uv[:, 0] - 0.5 * size[0], -uv[:, 1], np.full(self.count, 3e-3)], axis=1)
        waves = np.cos(np.pi * np.outer(uv[:, 0] / size[0], np.arange(4)))[:, :, None]
        waves = (waves * np.cos(np.pi * np.outer(uv[:, 1] / size[1], np.arange(4)))[:, None]).reshape(self.count, -1)
        fields = waves @ self.rng.standard_normal((16, 4))
        x[:, 2] += 0.02 * (fields[:, 3] - fields[:, 3].min()) / np.ptp(fields[:, 3])
        push = fields[:, :3] / np.sqrt((fields[:, :3] ** 2).mean()) * 9.81 * self.mass[:, None]
        start, velocity, weight = x[self.held].copy(), np.zeros_like(x), self.force.copy()
        for step in range(STEPS):
            along = min(1.0, 2.0 * (step + 1) / STEPS)
            self.force = weight + push * max(0.0, 1.0 - 1.7 * step / STEPS)
            before = x.copy()
            x[self.held] = (1 - along) * start + along * self.home
            x = self._step(x, before + STEP_S * velocity * self.free[:, None], STEP_S)
            velocity = 0.9 * (x - before) / STEP_S
        self.force = weight
        return self.settle(x)

    def settle(self, x: Array) -> tuple[Array, float]:
        """Ever longer steps without memory of speed, magnets at home, from positions [vertices, 3]; see ``drape``."""
        x = x.copy()
        x[self.held] = self.home
        step_s, left = STEP_S, math.inf
        for _ in range(SETTLING):
            before = self.forces(x)[0]
            moved = self._step(x, x, step_s, 1)
            energy, gradient, _ = self.forces(moved)
            step_s = min(10.0, step_s * 1.5) if energy < before else step_s * 0.4
            if energy < before:
                x = moved
            left = float(np.sqrt((gradient[self.free] ** 2).sum(1).mean())) / self.weight
            if left < REST or step_s < 1e-4:
                break
        return x, left

    def _step(self, x: Array, goal: Array, step_s: float, rounds: int = 2) -> Array:
        """Implicit Euler by a few Newton steps."""
        inertia = (self.mass / step_s**2)[:, None]
        for _ in range(rounds):
            _, gradient, values = self.forces(x, hessian=True)
            assert values is not None
            gradient = (gradient + inertia * (x - goal)) * self.free[:, None]
            values[self.blocked] = 0.0
            values[self.diagonal] += np.repeat(inertia[:, 0], 3)
            self.factorisation.factor(values)
            move = -self.factorisation.solve(gradient.ravel()).reshape(x.shape)
            move[~self.free] = 0.0
            longest = float(np.abs(move).max())
            x = x + min(1.0, 0.02 / max(longest, 1e-12)) * move
            if longest < 1e-5:
                break
        return x
