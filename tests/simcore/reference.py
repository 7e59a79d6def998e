"""The cloth's energy, its gradient and the residual in plain NumPy, written from ``docs/conventions.md`` alone.

Apart from the kernels on purpose: array slices instead of a gather, its own constants, its own plate coefficients. The
energy also takes complex positions, so that a complex step (Squire and Trapp 1998) checks the gradient to rounding.

Positions: float64 (or complex128) [rows, columns, 3], metres, panel frame; row j runs down warp (v), column i along
weft (u).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simcore.mechanics import Mechanics
from simcore.parameters import FabricParameters

from .reference_self_contact import own_contact_energy, own_contact_gradient

Array = NDArray[Any]

BARRIER_REACH_M = 1e-3
BARRIER_WEIGHTS = 5.0
SLIP_M = 5e-4
HOURGLASS = 0.1
POISSON = 0.3
LEAST_MIXED = -2.0 * 0.98
STANDARD_GRAVITY = 9.81


@dataclass(frozen=True)
class Friction:
    """Lagged friction: ``bound``, coefficient times normal force [N], per vertex; ``anchor`` [rows, columns, 2] [m]."""

    bound: Array
    anchor: Array


@dataclass(frozen=True)
class Cloth:
    """A problem: grid, material, what acts on it and what is held (bool [rows, columns]).

    ``own_contact``: parts of the cloth so many cells apart keep off each other (``reference_self_contact``); 0: none.
    """

    fabric: FabricParameters
    hu: float
    hv: float
    held: Array
    mechanics: Mechanics = field(default_factory=Mechanics)
    panel: bool = True
    friction: Friction | None = None
    own_contact: int = 0

    # -- measures of the grid ------------------------------------------------------------------------------------

    def areas(self) -> Array:
        """Area of each vertex: a quarter of every cell that touches it [m²]."""
        rows, columns = self.held.shape
        area = np.zeros((rows, columns))
        for dj in (0, 1):
            for di in (0, 1):
                area[dj : rows - 1 + dj, di : columns - 1 + di] += 0.25 * self.hu * self.hv
        return area

    def weight(self) -> float:
        """Weight of an inner vertex [N]."""
        return self.fabric.density * self.hu * self.hv * float(np.linalg.norm(self.mechanics.gravity))

    def force(self) -> Array:
        """Gravity of cloth, hem and trims, and the draft [N]."""
        area = self.areas()
        mass = self.fabric.density * area
        edge = np.full(area.shape[1], self.hu)
        edge[[0, -1]] = 0.5 * self.hu
        side = np.full(area.shape[0], self.hv)
        side[[0, -1]] = 0.5 * self.hv
        left, right, top, bottom = self.mechanics.trim_kg_m
        mass[-1] += self.mechanics.hem_kg_m * edge + bottom * edge
        mass[0] += top * edge
        mass[:, 0] += left * side
        mass[:, -1] += right * side
        force = mass[:, :, None] * np.array(self.mechanics.gravity)
        force[:, :, 2] += self.mechanics.air_pressure_pa * area
        return force

    # -- plate ---------------------------------------------------------------------------------------------------

    def plate(self) -> tuple[float, float, float, float, float, float]:
        """(D_11, D_22, D_12, D_66, D_16, D_26) in the sample's axes [N·m]."""
        f = self.fabric
        root = math.sqrt(f.bending_warp * f.bending_weft)
        mixed = max(4.0 * f.bending_bias - f.bending_warp - f.bending_weft, LEAST_MIXED * root)
        d12 = min(POISSON * root, mixed / 2.0)
        d66 = (mixed - 2.0 * d12) / 4.0
        # rotate the fourth-order tensor
        d = np.zeros((2, 2, 2, 2))
        d[0, 0, 0, 0], d[1, 1, 1, 1] = f.bending_weft, f.bending_warp
        d[0, 0, 1, 1] = d[1, 1, 0, 0] = d12
        d[0, 1, 0, 1] = d[0, 1, 1, 0] = d[1, 0, 0, 1] = d[1, 0, 1, 0] = d66
        c, s = math.cos(self.mechanics.off_grain_rad), math.sin(self.mechanics.off_grain_rad)
        turn = np.array([[c, s], [-s, c]])  # rows: the material's weft and warp in the sample's (u, v)
        t = np.einsum("abcd,ai,bj,ck,dl->ijkl", d, turn, turn, turn, turn)
        return t[0, 0, 0, 0], t[1, 1, 1, 1], t[0, 0, 1, 1], t[0, 1, 0, 1], t[0, 0, 0, 1], t[1, 1, 0, 1]

    def curvatures(self, x: Array) -> tuple[Array, Array, Array]:
        """x_uu [rows, columns - 2, 3], x_vv [rows - 2, columns, 3], x_uv [rows - 1, columns - 1, 3]."""
        uu = np.diff(x, 2, axis=1) / self.hu**2
        vv = np.diff(x, 2, axis=0) / self.hv**2
        uv = np.diff(np.diff(x, axis=0), axis=1) / (self.hu * self.hv)
        return uu, vv, uv

    def bending_energy(self, x: Array) -> Any:
        """[J]"""
        d11, d22, d12, d66, d16, d26 = self.plate()
        uu, vv, uv = self.curvatures(x)
        area = self.areas()
        cell = self.hu * self.hv
        return (
            0.5 * d11 * np.einsum("ji,jic,jic->", area[:, 1:-1], uu, uu)
            + 0.5 * d22 * np.einsum("ji,jic,jic->", area[1:-1, :], vv, vv)
            + d12 * cell * np.einsum("jic,jic->", uu[1:-1], vv[:, 1:-1])
            + 2.0 * d66 * cell * np.einsum("jic,jic->", uv, uv)
            + 2.0 * cell * np.einsum("jic,jic->", d16 * uu[1:-1] + d26 * vv[:, 1:-1], self.inner_twist(uv))
        )

    @staticmethod
    def inner_twist(uv: Array) -> Array:
        """Mean of the four cells round each inner vertex, [rows - 2, columns - 2, 3]."""
        return (uv[:-1, :-1] + uv[:-1, 1:] + uv[1:, :-1] + uv[1:, 1:]) / 4.0

    def bending_gradient(self, x: Array) -> Array:
        """[N]"""
        d11, d22, d12, d66, d16, d26 = self.plate()
        uu, vv, uv = self.curvatures(x)
        area = self.areas()
        cell = self.hu * self.hv
        by_uu = d11 * area[:, 1:-1, None] * uu
        by_vv = d22 * area[1:-1, :, None] * vv
        by_uu[1:-1] += d12 * cell * vv[:, 1:-1]
        by_vv[:, 1:-1] += d12 * cell * uu[1:-1]
        twist = 2.0 * cell * self.inner_twist(uv)
        by_uu[1:-1] += d16 * twist
        by_vv[:, 1:-1] += d26 * twist
        by_uv = 4.0 * d66 * cell * uv
        by_mean = 2.0 * cell * (d16 * uu[1:-1] + d26 * vv[:, 1:-1])
        for dj in (0, 1):
            for di in (0, 1):
                by_uv[dj : dj + by_mean.shape[0], di : di + by_mean.shape[1]] += by_mean / 4.0
        by_uv /= self.hu * self.hv
        g = np.zeros_like(x)
        for shift, factor in ((0, 1.0), (1, -2.0), (2, 1.0)):
            g[:, shift : shift + uu.shape[1]] += factor * by_uu / self.hu**2
            g[shift : shift + vv.shape[0], :] += factor * by_vv / self.hv**2
        for dj in (0, 1):
            for di in (0, 1):
                g[dj : dj + uv.shape[0], di : di + uv.shape[1]] += (2 * dj - 1) * (2 * di - 1) * by_uv
        return g

    # -- rest curvature ------------------------------------------------------------------------------------------

    def moments(self) -> tuple[Array, Array]:
        """Area times moment of the rest curvature along u and v [N·m²], zero where there is no second difference."""
        rows, columns = self.held.shape
        v, u = np.meshgrid(np.arange(rows) * self.hv, np.arange(columns) * self.hu, indexing="ij")
        size = ((columns - 1) * self.hu, (rows - 1) * self.hv)
        weft, warp = np.zeros((rows, columns)), np.zeros((rows, columns))
        for rest in self.mechanics.rest_curvature:
            # the mean over the two cells at either side that a tent over them gives, in parts of 2.5 mm
            for step, along_u in ((self.hu, True), (self.hv, False)):
                n = max(2, math.ceil(step / 2.5e-3))
                for k in range(-n, n):
                    away = (k + 0.5) / n
                    share = (1.0 - abs(away)) / n
                    if along_u:
                        weft = weft + share * rest.evaluate(np.clip(u + away * step, 0, size[0]), v, size)[0]
                    else:
                        warp = warp + share * rest.evaluate(u, np.clip(v + away * step, 0, size[1]), size)[1]
        d11, d22, d12, *_ = self.plate()
        area = self.areas()
        mu, mv = area * d11 * weft, area * d22 * warp
        inner = np.zeros((rows, columns))
        inner[1:-1, 1:-1] = area[1:-1, 1:-1]
        mu, mv = mu + inner * d12 * warp, mv + inner * d12 * weft
        mu[:, [0, -1]] = 0.0
        mv[[0, -1], :] = 0.0
        return mu, mv

    def _curl_parts(self, x: Array) -> tuple[Array, Array, Array]:
        """Weighted second differences, and differences across each vertex along u and v; the border repeats itself."""
        mu, mv = self.moments()
        p = np.pad(x, ((1, 1), (1, 1), (0, 0)), mode="edge")
        left, right, up, down = p[1:-1, :-2], p[1:-1, 2:], p[:-2, 1:-1], p[2:, 1:-1]
        bend = mu[..., None] / self.hu**2 * (left + right - 2 * x) + mv[..., None] / self.hv**2 * (up + down - 2 * x)
        return bend, right - left, down - up

    def curl_energy(self, x: Array) -> Any:
        """Work of the rest curvature's moment [J]."""
        if not self.mechanics.rest_curvature:
            return 0.0
        bend, a, d = self._curl_parts(x)
        normal = np.cross(d, a)
        return -np.sum(np.sum(bend * normal, axis=2) / np.sqrt(np.sum(normal**2, axis=2)))

    def curl_gradient(self, x: Array) -> Array:
        """[N]"""
        g = np.zeros_like(x)
        if not self.mechanics.rest_curvature:
            return g
        mu, mv = self.moments()
        bend, a, d = self._curl_parts(x)
        big = np.cross(d, a)
        size = np.linalg.norm(big, axis=2, keepdims=True)
        unit = big / size
        by_big = -(bend - unit * np.sum(unit * bend, axis=2, keepdims=True)) / size
        by_a, by_d = np.cross(by_big, d), np.cross(a, by_big)
        along_u, along_v = mu[..., None] / self.hu**2 * unit, mv[..., None] / self.hv**2 * unit
        # gathered on a grid with a margin, whose values then go to the border that it repeats
        wide = np.zeros((x.shape[0] + 2, x.shape[1] + 2, 3))
        wide[1:-1, 1:-1] += 2.0 * (along_u + along_v)
        wide[1:-1, :-2] += -along_u - by_a
        wide[1:-1, 2:] += -along_u + by_a
        wide[:-2, 1:-1] += -along_v - by_d
        wide[2:, 1:-1] += -along_v + by_d
        wide[1] += wide[0]
        wide[-2] += wide[-1]
        wide[:, 1] += wide[:, 0]
        wide[:, -2] += wide[:, -1]
        g += wide[1:-1, 1:-1]
        return g

    # -- membrane ------------------------------------------------------------------------------------------------

    def _cells(self, x: Array) -> tuple[Array, Array, Array]:
        """x_u and x_v at the centre of each cell and the twist difference of its corners."""
        p, q, r, s = x[:-1, :-1], x[:-1, 1:], x[1:, :-1], x[1:, 1:]
        return (q - p + s - r) / (2 * self.hu), (r - p + s - q) / (2 * self.hv), p - q - r + s

    def _strain(self, a: Array, b: Array) -> tuple[Array, Array, Array]:
        """Green-Lagrange strain along the material's weft and warp, and their shear 2 E."""
        c, s = math.cos(self.mechanics.off_grain_rad), math.sin(self.mechanics.off_grain_rad)
        weft, warp = c * a + s * b, -s * a + c * b
        # with F d the stretched unit direction d: |F d|² = 1 + 2 d.E d
        return (
            0.5 * (np.sum(weft**2, axis=2) - 1.0),
            0.5 * (np.sum(warp**2, axis=2) - 1.0),
            np.sum(weft * warp, axis=2),
        )

    def _tensile(self, strain: Array) -> Array:
        """1 / e_2² where the fibre is in tension."""
        limit = self.mechanics.stiffening_strain
        return np.where(strain.real > 0.0, 0.0 if limit is None else limit**-2, 0.0)

    def _hourglass(self) -> Array:
        """Share of the hourglass stiffness of each cell: all of it where a corner is held."""
        h = self.held
        return np.where(h[:-1, :-1] | h[:-1, 1:] | h[1:, :-1] | h[1:, 1:], 1.0, HOURGLASS)

    def membrane_energy(self, x: Array) -> Any:
        """[J]"""
        f, cell = self.fabric, self.hu * self.hv
        a, b, q = self._cells(x)
        e_weft, e_warp, shear = self._strain(a, b)
        total = 0.5 * f.stretch_bias * np.sum(shear**2)
        for k, e in ((f.stretch_weft, e_weft), (f.stretch_warp, e_warp)):
            total += k * np.sum(e**2 / 2 + self._tensile(e) * e**4 / 12)
        for k, t, h in ((f.stretch_weft, a, self.hu), (f.stretch_warp, b, self.hv)):
            total += k / (24 * h**2) * np.sum(self._hourglass() * np.sum(t * q, axis=2) ** 2)
        return cell * total

    def membrane_gradient(self, x: Array) -> Array:
        """[N]"""
        f, cell = self.fabric, self.hu * self.hv
        angle = self.mechanics.off_grain_rad
        c, s = math.cos(angle), math.sin(angle)
        a, b, q = self._cells(x)
        weft, warp = c * a + s * b, -s * a + c * b
        e_weft, e_warp, shear = self._strain(a, b)
        n_weft = f.stretch_weft * (e_weft + self._tensile(e_weft) * e_weft**3 / 3)
        n_warp = f.stretch_warp * (e_warp + self._tensile(e_warp) * e_warp**3 / 3)
        n_shear = f.stretch_bias * shear
        by_weft = n_weft[..., None] * weft + n_shear[..., None] * warp
        by_warp = n_warp[..., None] * warp + n_shear[..., None] * weft
        by_a, by_b = c * by_weft - s * by_warp, s * by_weft + c * by_warp
        by_q = np.zeros_like(q)
        for k, t, h, by_t in ((f.stretch_weft, a, self.hu, by_a), (f.stretch_warp, b, self.hv, by_b)):
            across = self._hourglass()[..., None] * k / (12 * h**2) * np.sum(t * q, axis=2, keepdims=True)
            by_t += across * q
            by_q += across * t
        g = np.zeros_like(x)
        rows, columns = self.held.shape
        for dj in (0, 1):
            for di in (0, 1):
                su, sv = 2 * di - 1, 2 * dj - 1
                g[dj : rows - 1 + dj, di : columns - 1 + di] += cell * (
                    su * by_a / (2 * self.hu) + sv * by_b / (2 * self.hv) + su * sv * by_q
                )
        return g

    # -- panel ---------------------------------------------------------------------------------------------------

    def panel_energy(self, x: Array) -> Any:
        """Barrier, adhesion and friction [J]; only of free vertices."""
        if not self.panel:
            return 0.0
        m, area, z = self.mechanics, self.areas(), x[..., 2]
        free = ~self.held
        total: Any = 0.0
        near = free & (z.real < BARRIER_REACH_M)
        if np.any(z[near].real <= 0.0):
            return math.inf
        scale = BARRIER_WEIGHTS * self.fabric.density * STANDARD_GRAVITY * area[near] * BARRIER_REACH_M
        t = z[near] / BARRIER_REACH_M
        total -= np.sum(scale * (t - 1) ** 2 * np.log(t))
        if m.adhesion_pa:
            near = free & (z.real < m.adhesion_range_m)
            t = z[near] / m.adhesion_range_m
            peak = 3.0 * math.sqrt(3.0) / 8.0 * m.adhesion_pa
            total -= np.sum(peak * area[near] * m.adhesion_range_m * (1 - t**2) ** 2)
        if self.friction is not None:
            shift = x[..., :2] - self.friction.anchor
            total += np.sum(self.friction.bound * (np.sqrt(np.sum(shift**2, axis=2) + SLIP_M**2) - SLIP_M))
        return total

    def panel_gradient(self, x: Array) -> Array:
        """[N]"""
        g = np.zeros_like(x)
        if not self.panel:
            return g
        m, area, z = self.mechanics, self.areas(), x[..., 2]
        free = ~self.held
        t = z / BARRIER_REACH_M
        near = free & (t < 1.0)
        safe = np.where(near, t, 0.5)
        push = 2 * (safe - 1) * np.log(safe) + (safe - 1) ** 2 / safe
        g[..., 2] -= near * BARRIER_WEIGHTS * self.fabric.density * STANDARD_GRAVITY * area * push
        if m.adhesion_pa:
            t = z / m.adhesion_range_m
            pull = 3.0 * math.sqrt(3.0) / 8.0 * m.adhesion_pa * 4 * t * (1 - t**2)
            g[..., 2] += np.where(free & (t < 1.0), area * pull, 0.0)
        if self.friction is not None:
            shift = x[..., :2] - self.friction.anchor
            root = np.sqrt(np.sum(shift**2, axis=2, keepdims=True) + SLIP_M**2)
            g[..., :2] += self.friction.bound[..., None] * shift / root
        return g

    # -- all together --------------------------------------------------------------------------------------------

    def energy(self, x: Array) -> Any:
        """Total potential energy [J]."""
        own = own_contact_energy(x, self.hu, self.hv, self.weight(), self.own_contact) if self.own_contact else 0.0
        contact = self.panel_energy(x) + own
        inner = self.membrane_energy(x) + self.bending_energy(x) + self.curl_energy(x)
        return inner + contact - np.sum(self.force() * x)

    def gradient(self, x: Array) -> Array:
        """Derivative of the energy by the free vertices [N], zero where held."""
        g = (
            self.membrane_gradient(x) + self.bending_gradient(x) + self.curl_gradient(x) + self.panel_gradient(x)
        ) - self.force()
        if self.own_contact:
            g += own_contact_gradient(x, self.hu, self.hv, self.weight(), cells=self.own_contact)
        return np.where(self.held[..., None], 0.0, g)

    def residual(self, x: Array) -> float:
        """Root mean square out-of-balance force of the free vertices, in weights of an inner vertex."""
        forces = np.linalg.norm(self.gradient(x), axis=2)[~self.held]
        return float(np.sqrt(np.mean(forces**2)) / self.weight())


def complex_step_gradient(cloth: Cloth, x: Array) -> Array:
    """Derivative of :meth:`Cloth.energy` without a difference of nearby numbers [N]."""
    g = np.zeros(x.shape)
    for at in np.ndindex(x.shape):
        if not cloth.held[at[:2]]:
            z = x.astype(np.complex128)
            z[at] += 1e-30j
            g[at] = cloth.energy(z).imag / 1e-30
    return g
