"""Drapes judged by NumPy and SciPy alone."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import eigsh

from simcore.drape import Drape
from simcore.mechanics import Jitter, Mechanics
from simcore.parameters import FabricParameters
from simcore.placement import Perturbation
from simcore.scenes import Setup

from .reference import Cloth, Friction
from .reference_self_contact import own_contact_stiffness

Array = NDArray[Any]

CORNERS = {"top_left": (0, 0), "top_right": (0, -1), "bottom_right": (-1, -1)}


def positions(drape: Drape) -> Array:
    """Vertices as [rows, columns, 3]."""
    return drape.vertices.reshape(drape.mesh.rows, drape.mesh.columns, 3)


def held_places(drape: Drape, setup: Setup, jitter: Jitter, seed: int) -> tuple[Array, Array]:
    """Which vertices the magnets hold (bool) and where they have to be [rows, columns, 3]."""
    rows, columns = drape.mesh.rows, drape.mesh.columns
    u, v = np.meshgrid(np.arange(columns) * drape.mesh.resolution_m, np.arange(rows) * drape.mesh.resolution_m)
    moves = Perturbation.draw(setup, jitter, np.random.SeedSequence(seed)).pin_moves
    home = {name: np.add(place, move) for (name, place), move in zip(setup.pins_m.items(), moves, strict=True)}
    held, places = np.zeros((rows, columns), dtype=bool), np.zeros((rows, columns, 3))
    for name, (j, i) in CORNERS.items():
        if name in home:
            du, dv = u - u[0, i], v - v[j, 0]
            patch = np.hypot(du, dv) <= setup.pin_radius_m + 1e-9
            held |= patch
            places[patch] = (home[name] + np.stack([du, -dv, 0 * du], axis=2))[patch]
    return held, places


def cloth_of(
    drape: Drape,
    fabric: FabricParameters,
    setup: Setup,
    mechanics: Mechanics = Mechanics(),
    jitter: Jitter = Jitter(),
    seed: int = 0,
    friction: Friction | None = None,
    own_contact: int = 0,
) -> Cloth:
    """The reference of the problem that the drape says it solves."""
    held, _ = held_places(drape, setup, jitter, seed)
    h = drape.mesh.resolution_m
    return Cloth(fabric, h, h, held, mechanics, setup.panel, friction, own_contact)


def stiffness_matrix(cloth: Cloth, x: Array) -> sp.csc_array:
    """Hessian over the free coordinates by central differences of the reference's gradient.

    Vertices couple up to two rows or columns away, so one difference serves all vertices five apart; those of parts in
    touch couple as they lie, and are taken one by one.
    """
    rows, columns, _ = x.shape
    step = 1e-7
    alone = replace(cloth, own_contact=0)
    j, i = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    entries: list[tuple[Array, Array, Array]] = []
    for dj in range(5):
        for di in range(5):
            chosen = (j % 5 == dj) & (i % 5 == di)
            # the chosen vertex that each vertex is near to
            near_j, near_i = j - (j - dj + 2) % 5 + 2, i - (i - di + 2) % 5 + 2
            inside = (near_j >= 0) & (near_j < rows) & (near_i >= 0) & (near_i < columns)
            for axis in range(3):
                d = np.zeros_like(x)
                d[chosen, axis] = step
                change = (alone.gradient(x + d) - alone.gradient(x - d)) / (2 * step)
                column = 3 * (near_j * columns + near_i) + axis
                entries += [
                    ((3 * (j * columns + i) + r)[inside], column[inside], change[..., r][inside]) for r in range(3)
                ]
    row, column, value = (np.concatenate([e[n] for e in entries]) for n in range(3))
    whole = sp.csc_array((value, (row, column)), shape=(x.size, x.size))
    if cloth.own_contact:
        whole += own_contact_stiffness(x, cloth.hu, cloth.hv, cloth.weight(), cloth.own_contact)
    free = np.flatnonzero(np.repeat(~cloth.held.ravel(), 3))
    part = whole[free][:, free]
    return sp.csc_array(0.5 * (part + part.T))


def lowest_stiffness(cloth: Cloth, x: Array) -> float:
    """Smallest eigenvalue of the Hessian by SciPy [N/m], in weights of a vertex per cell."""
    matrix = stiffness_matrix(cloth, x)
    # shifted below zero, so that the nearest eigenvalues are the lowest ones, negative or not
    value = eigsh(matrix, k=3, sigma=-cloth.weight() / cloth.hu, which="LM", return_eigenvectors=False).min()
    return float(value) * cloth.hu / cloth.weight()
