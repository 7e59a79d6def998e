"""Energy, gradient and Hessian of the cloth on one grid, with all fields kept between solves."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simcore import curl_kernels, kernels
from simcore.bending import PlateRigidity
from simcore.contact import PanelContact
from simcore.grid import BendingForms, Grid
from simcore.inner import inner, norm
from simcore.mechanics import Mechanics
from simcore.parameters import FabricParameters
from simcore.pardiso import Factorisation
from simcore.self_contact import SelfContact

Array = NDArray[np.float64]
ROUGH_FROM = 2000
"""Vertices of a grid beyond which directions far from rest come from a factorisation in single precision."""


@dataclass(frozen=True)
class Load:
    """What a fabric and its mechanics put on a level's vertices.

    Attributes:
        mass: [kg], shape [rows, columns].
        force: constant force [N], shape [rows, columns, 3].
        weight: weight of an interior vertex [N], the unit of residuals.
    """

    mass: Array
    force: Array
    weight: float

    @classmethod
    def of(cls, grid: Grid, fabric: FabricParameters, mechanics: Mechanics) -> Load:
        """Gravity, hem and a uniform draft, lumped to vertices."""
        mass = fabric.density * grid.areas
        hem = grid.areas[-1] / (0.5 * grid.hv)  # length of the bottom edge that each of its vertices stands for
        mass[-1] += mechanics.hem_kg_m * hem
        force = mass[..., None] * np.asarray(mechanics.gravity)
        force[..., 2] += mechanics.air_pressure_pa * grid.areas
        gravity = math.sqrt(sum(g * g for g in mechanics.gravity))
        return cls(mass, force, fabric.density * grid.hu * grid.hv * gravity)


def rest_moments(grid: Grid, plate: PlateRigidity, mechanics: Mechanics) -> Array | None:
    """Area times the moment of the rest curvature over h², along u and v, shape [rows, columns, 2] [N]; None for none.

    A second difference that would leave the grid has none.
    """
    if not mechanics.rest_curvature:
        return None
    v, u = np.meshgrid(np.arange(grid.rows) * grid.hv, np.arange(grid.columns) * grid.hu, indexing="ij")
    size = ((grid.columns - 1) * grid.hu, (grid.rows - 1) * grid.hv)
    fields = [field.evaluate(u, v, size) for field in mechanics.rest_curvature]
    weft, warp = sum(f[0] for f in fields), sum(f[1] for f in fields)
    # the plate couples its curvatures at inner vertices only: coupled at the border too, a free sheet would not rest
    coupled = np.zeros((grid.rows, grid.columns))
    coupled[1:-1, 1:-1] = plate.coupling * grid.hu * grid.hv
    moments = np.zeros((grid.rows, grid.columns, 2))
    moments[..., 0] = (plate.weft * grid.areas * weft + coupled * warp) / grid.hu**2
    moments[..., 1] = (plate.warp * grid.areas * warp + coupled * weft) / grid.hv**2
    moments[:, [0, -1], 0] = 0.0
    moments[[0, -1], :, 1] = 0.0
    return moments


class Level:
    """One grid of the cascade.

    Holds the constant operators, the factorisation and scratch fields; :meth:`load` sets a fabric. Positions are
    float64 arrays of shape [rows, columns, 3] in the panel frame.
    """

    def __init__(self, grid: Grid) -> None:
        self.grid = grid
        self.forms = BendingForms.of(grid)
        self._indptr, self._indices, self._slot = grid.pattern
        self.exact = Factorisation(self._indptr, self._indices)
        self.rough = (
            Factorisation(self._indptr, self._indices, single=True)
            if grid.rows * grid.columns > ROUGH_FROM
            else self.exact
        )
        self._factored = self.exact
        rows, columns = grid.rows, grid.columns
        self._values: Array = np.zeros(len(self._indices))
        self._vertex_energy: Array = np.zeros((rows, columns))
        self._cell_forces: Array = np.zeros((rows - 1, columns - 1, 9))
        self._cell_hessians: Array = np.zeros((rows - 1, columns - 1, 54))
        self.fixed = np.zeros((rows, columns), dtype=np.int32)
        self.extra_force: Array = np.zeros(grid.shape)

    def set_up(
        self,
        fabric: FabricParameters,
        mechanics: Mechanics,
        contact: PanelContact,
        fixed: NDArray[np.int32],
        own_contact: bool = False,
    ) -> None:
        """Choose what is solved next: fabric, mechanics, contact and the held vertices (int32, 1 = held).

        ``own_contact``: parts of the cloth keep off each other.
        """
        angle = mechanics.off_grain_rad
        plate = PlateRigidity.of(fabric).turned(angle)
        stiffening = 0.0 if mechanics.stiffening_strain is None else mechanics.stiffening_strain**-2
        stretch = (fabric.stretch_weft, fabric.stretch_warp, fabric.stretch_bias)
        turn = (math.cos(angle), math.sin(angle))
        self.membrane = np.array([*stretch, *turn, stiffening, self.grid.hu, self.grid.hv])
        self.bending = self.forms.stencil(plate.weft, plate.warp, plate.coupling, plate.twist)
        self.loads = Load.of(self.grid, fabric, mechanics)
        self.moments = rest_moments(self.grid, plate, mechanics)
        self.contact = contact
        self.fixed = fixed
        touched = fixed[:-1, :-1] + fixed[:-1, 1:] + fixed[1:, :-1] + fixed[1:, 1:]
        self.hourglass = np.where(touched > 0, 1.0, kernels.HOURGLASS)
        self.extra_force[:] = 0.0
        self.own_contact = SelfContact(self.grid, self.loads.weight, fixed) if own_contact else None

    def energy(self, x: Array) -> float:
        """Total potential energy [J]; infinite where a vertex is behind the panel or the cloth crosses itself."""
        contact = self.contact.energy(x, self.fixed)
        if self.own_contact is not None:
            contact += self.own_contact.energy(x)
        if not math.isfinite(contact):
            return math.inf
        elastic = kernels.membrane_energy(x, self.membrane, self.hourglass, self._vertex_energy)
        bending = kernels.form_energy(x, self.bending, self._vertex_energy)
        curl = 0.0 if self.moments is None else curl_kernels.curl_energy(x, self.moments)
        return float(elastic + bending + curl + contact - inner(self.loads.force + self.extra_force, x))

    def gradient(self, x: Array) -> Array:
        """Derivative of the energy [N], zero where held."""
        out = np.empty(self.grid.shape)
        kernels.membrane_cell_forces(x, self.membrane, self.hourglass, self._cell_forces)
        force = self.loads.force + self.extra_force
        kernels.gather_gradient(x, self._cell_forces, self.bending, force, self.fixed, out)
        if self.moments is not None:
            curl_kernels.curl_gradient(x, self.moments, self.fixed, out)
        self.contact.add_gradient(x, self.fixed, out)
        if self.own_contact is not None:
            self.own_contact.add_gradient(x, out)
        return out

    def residual(self, gradient: Array) -> float:
        """RMS out-of-balance force per free vertex, in weights of an interior vertex."""
        free = self.fixed.size - int(self.fixed.sum())
        return norm(gradient) / math.sqrt(max(free, 1)) / self.loads.weight

    def factor(self, x: Array, blend: float, shift: Array | float = 0.0, rough: bool = False) -> int:
        """Assemble and factor the Hessian, blended towards a positive one, plus a diagonal ``shift`` [N/m] a vertex.

        ``rough``: in single precision.

        Returns:
            The number of its negative eigenvalues.
        """
        kernels.membrane_cell_hessians(x, self.membrane, self.hourglass, blend, self._cell_hessians)
        vertex = self.contact.hessian(x, self.fixed, blend)
        vertex[..., :3] += shift[..., None] if isinstance(shift, np.ndarray) else shift
        stiffness = float(self.membrane[:3].max())
        kernels.assemble(
            self._cell_hessians, self.bending, vertex, self.fixed, self._slot, self._indptr, stiffness, self._values
        )
        if self.moments is not None and blend > 0.0:
            curl_kernels.curl_hessian(x, self.moments, blend, self.fixed, self._slot, self._indptr, self._values)
        touching = None if self.own_contact is None else self.own_contact.hessian(x)
        if touching is not None:
            return self._factor_touching(touching)
        self._factored = self.rough if rough else self.exact
        return self._factored.factor(self._values)

    def _factor_touching(self, touching: Any) -> int:
        """Factor the assembled Hessian plus that of parts in touch, whose pattern is new each time."""
        import scipy.sparse as sp

        own = sp.csr_array((self._values, self._indices, self._indptr), shape=touching.shape)
        whole = sp.csr_array(own + sp.triu(touching, format="csr"))
        whole.sort_indices()
        self._factored = Factorisation(whole.indptr.astype(np.int32), whole.indices.astype(np.int32))
        return self._factored.factor(whole.data)

    def solve(self, right: Array) -> Array:
        """Solve with the last factorisation; shapes [rows, columns, 3]."""
        return self._factored.solve(right.ravel()).reshape(self.grid.shape)

    def soft_modes(self, count: int, start: Array, rounds: int) -> tuple[Array, Array]:
        """Eigenpairs nearest zero of the last factored Hessian, by subspace iteration with its inverse.

        Args:
            count: how many.
            start: vectors to start from, shape [at least count, n].
            rounds: iterations.

        Returns:
            Eigenvalue estimates [N/m], ascending, shape [count]; unit vectors, shape [count, n].
        """
        basis = start[:count].copy()
        basis.reshape(count, -1, 3)[:, self.fixed.ravel() == 1] = 0.0
        inverse: Array = np.zeros(count)
        for _ in range(rounds):
            q, _ = np.linalg.qr(basis.T)
            orthonormal = np.ascontiguousarray(q.T)
            basis = self._factored.solve(orthonormal)
            inverse, turn = np.linalg.eigh(orthonormal @ basis.T)
            basis = turn.T @ basis
        vectors = basis / np.linalg.norm(basis, axis=1, keepdims=True)
        values = 1.0 / inverse
        order = np.argsort(values)
        return values[order], vectors[order]
