"""Energy, gradient and Hessian of one cloth on one grid, with all fields kept between solves."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simcore.bending_forms import BendingForms
from simcore.cloths import Cloths
from simcore.contact import PanelContact
from simcore.elimination import elimination_order
from simcore.grid import Grid, Pattern
from simcore.inner import norm
from simcore.loads import Load
from simcore.mechanics import Mechanics
from simcore.model import Model
from simcore.panel_kernels import BEHIND
from simcore.parameters import FabricParameters
from simcore.pardiso import Factorisation
from simcore.self_contact import SelfContact

Array = NDArray[np.float64]


class Level:
    """One grid of the cascade.

    Holds the constant operators, the factorisation and scratch fields; :meth:`set_up` sets a fabric. Positions are
    float64 arrays of shape [rows, columns, 3] in the panel frame.
    """

    def __init__(self, grid: Grid) -> None:
        self.grid = grid
        self.forms = BendingForms.of(grid)
        self._systems: dict[bool, tuple[Pattern, Factorisation, Factorisation]] = {}
        self._take(skew=False)
        self._model = Model(grid, 1, np.zeros)
        self._which = np.zeros(1, dtype=np.int32)

    def set_up(
        self,
        fabric: FabricParameters,
        mechanics: Mechanics,
        contact: PanelContact,
        fixed: NDArray[np.int32],
        own_contact: int = 0,
    ) -> None:
        """Choose what is solved next: fabric, mechanics, contact and the held vertices (int32, 1 = held).

        ``own_contact``: parts of the cloth keep off each other that are so many cells apart; 0: none do.
        """
        self.contact = contact
        self.loads = Load.of(self.grid, fabric, mechanics)
        self.cloths = Cloths.one(self.grid, self.forms, fabric, mechanics, contact, fixed)
        self._take(self.cloths.skew is not None)
        self.own_contact = SelfContact(self.grid, self.loads.weight, fixed, own_contact) if own_contact else None

    def _take(self, skew: bool) -> None:
        """Turn to the pattern and factorisations of cloth that is, or is not, coupled as ``skew_kernels`` say."""
        if self._systems:
            self.forget()
        if skew not in self._systems:
            pattern = self.grid.skew_pattern if skew else self.grid.pattern
            order = elimination_order(self.grid.rows, self.grid.columns, skew)
            exact, rough = (Factorisation(pattern.indptr, pattern.indices, single, order) for single in (False, True))
            self._systems[skew] = (pattern, exact, rough)
        self.pattern, self.exact, self.rough = self._systems[skew]
        self._factored = self.exact

    def touch(self, contact: PanelContact) -> None:
        """Replace the panel's contact."""
        self.contact = contact
        self.cloths = replace(self.cloths, panel=contact.numbers()[None])

    def push(self, force: Array | float) -> None:
        """Add this force to every vertex from now on, in place of the last one [N], shape [rows, columns, 3]."""
        self.cloths = replace(self.cloths, load=(self.loads.force + force)[None])

    @property
    def fixed(self) -> NDArray[np.int32]:
        """Held vertices, 1 = held, shape [rows, columns]; set whole, not in place."""
        held: NDArray[np.int32] = self.cloths.fixed[0]
        return held

    @fixed.setter
    def fixed(self, held: NDArray[np.int32]) -> None:
        self.cloths = replace(self.cloths, fixed=np.ascontiguousarray(held[None], dtype=np.int32))

    def energy(self, x: Array) -> float:
        """Total potential energy [J]; infinite where a vertex is behind the panel or the cloth crosses itself."""
        own = 0.0 if self.own_contact is None else self.own_contact.energy(x)
        if own == math.inf:
            return math.inf
        energy = float(self._model.energies(self.cloths, self._which, x[None])[0])
        return math.inf if energy >= BEHIND else energy + own

    def gradient(self, x: Array) -> Array:
        """Derivative of the energy [N], zero where held."""
        out: Array = self._model.gradients(self.cloths, self._which, x[None])[0]
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
        shifts = np.broadcast_to(np.asarray(shift, dtype=np.float64), x.shape[:2]).copy()[None]
        stencil = self._model.hessians(self.cloths, self._which, x[None], np.array([blend]), shifts)
        skew = None if self.cloths.skew is None else self.cloths.skew_between_free()
        values = self.pattern.values(stencil, skew)
        touching = None if self.own_contact is None else self.own_contact.hessian(x)
        if touching is not None:
            return self._factor_touching(values, touching, rough)
        self._factored, other = (self.rough, self.exact) if rough else (self.exact, self.rough)
        if other is not self._factored:
            other.forget()  # on 5 mm cells 50 MB, or 25 in single precision
        return self._factored.factor(values)

    def _factor_touching(self, values: Array, touching: Any, rough: bool) -> int:
        """Factor the assembled Hessian plus that of parts in touch, whose pattern is new each time."""
        import scipy.sparse as sp

        own = sp.csr_array((values, self.pattern.indices, self.pattern.indptr), shape=touching.shape)
        whole = sp.csr_array(own + sp.triu(touching, format="csr"))
        whole.sort_indices()
        self._factored = Factorisation(whole.indptr.astype(np.int32), whole.indices.astype(np.int32), single=rough)
        return self._factored.factor(whole.data)

    def forget(self) -> None:
        """Give back the memory of factors; positions can be led on elsewhere meanwhile."""
        self.exact.forget()
        self.rough.forget()
        self._factored = self.exact

    def solve(self, right: Array) -> Array:
        """Solve with the last factorisation; shapes [rows, columns, 3], zero where held."""
        out = self._factored.solve(right.ravel()).reshape(self.grid.shape)
        out[self.fixed == 1] = 0.0  # pivoting mixes rows: what is left there is tiny, but would move a magnet
        return out

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
        basis.reshape(count, -1, 3)[:, self.fixed.ravel() == 1] = 0.0  # as in solve
        vectors = basis / np.linalg.norm(basis, axis=1, keepdims=True)
        values = 1.0 / inverse
        order = np.argsort(values)
        return values[order], vectors[order]
