"""Blocks made up for tests of where a gap lies: real cells, smooth errors, responses of plain form."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from diagnosis.effect import SCALAR
from diagnosis.effects import get_effect
from diagnosis.inference.block import Block, PixelBlock, View
from diagnosis.measurement.pixel_statistics import PIXEL_NAMES
from diagnosis.measurement.reference import CELLS, PLANE_NAMES, cell_centres
from diagnosis.simulation.sizes import at_all_places, nodes

Array = NDArray[np.float64]
NAMES = (*PIXEL_NAMES, *PLANE_NAMES)
CENTRE = cell_centres()
CLOTH = np.arange(len(CENTRE)) < CELLS * CELLS
EFFECTS = ("air_draft", "edge_curl", "pin_spacing", "range_noise", "depth_scale")
U, V = CENTRE.T
CURL = np.where(CLOTH & (np.minimum(U, 1 - U) < 1 / CELLS), 1.0, 0.0)
"""The sides are lifted, one cell wide; [cells + ring]."""
BULGE = np.where(CLOTH, np.sin(np.pi * U) * V, 0.0)
TIGHT = np.where(CLOTH, np.sin(np.pi * U) * (1 - 0.5 * V), 0.0)
"""Not unlike :data:`BULGE`."""
SHAPES: Mapping[str, Array] = {
    "air_draft": 0.010 * BULGE,
    "edge_curl": 0.006 * CURL,
    "pin_spacing": 0.008 * TIGHT,
    "range_noise": np.zeros(len(CENTRE)),
    "depth_scale": np.where(CLOTH, 0.001, 0.0),
}
"""Response to each effect at its largest size [m], [cells + ring]."""
FABRICS, REPEATS = 3, 2


def covariance(scale: float) -> Array:
    """Of the repeats of one fabric in one scene, errors of half a millimetre times a scale [m²], [n, n]."""
    distance = np.linalg.norm(CENTRE[:, None] - CENTRE[None], axis=2)
    kernel = np.exp(-0.5 * (distance / 0.15) ** 2)
    common = np.tile((0.0004 * scale) ** 2 * kernel, (REPEATS, REPEATS))
    own = np.kron(np.eye(REPEATS), (0.0003 * scale) ** 2 * kernel + (0.0001 * scale) ** 2 * np.eye(len(CENTRE)))
    return np.asarray(common + own)


def make_blocks(
    rng: np.random.Generator,
    added: Array | float = 0.0,
    scenes: tuple[str, ...] = ("hanging", "stretch"),
    scatter_m: float = 0.0,
) -> list[Block]:
    """Draws of the errors with a difference [m] added in every capture, [cells + ring].

    With ``scatter_m``, a bulge of another size in every capture.
    """
    responses = {name: response(name, np.tile(SHAPES[name], REPEATS)) for name in EFFECTS}
    blocks = []
    for scene in scenes:
        stated = covariance(3.0 if scene == "hanging" else 1.0)
        for fabric in range(FABRICS):
            factor = np.linalg.cholesky(stated)
            drawn = factor @ rng.standard_normal(len(stated))
            measured = drawn + np.tile(np.broadcast_to(added, len(CENTRE)), REPEATS)
            measured += scatter_m * np.kron(rng.standard_normal(REPEATS), BULGE)
            views = [_view(measured, responses, matrix) for matrix in (stated, 2.0 * stated)]
            still = np.zeros((4, len(measured)))
            cell, owner = np.tile(np.arange(len(CENTRE)), REPEATS), np.repeat(np.arange(REPEATS), len(CENTRE))
            ids = tuple(f"f{fabric}-{scene}-{k}" for k in range(REPEATS))
            blocks.append(
                Block(f"f{fabric}", scene, ids, views[0], views[1], cell, owner, np.zeros((7, len(cell))), still, still)
            )
    return blocks


def make_pixels(rng: np.random.Generator, added: Array | float = 0.0) -> PixelBlock:
    """Shared numbers with something added [standard deviations], [numbers]."""
    loud = np.where(np.array(NAMES) == "log_noise", 60.0, 0.0)
    shown = {"range_noise": loud, "depth_scale": np.where(np.array(NAMES) == "panel_offset", 50.0, 0.0)}
    rows = {name: response(name, shown.get(name, np.zeros(len(NAMES)))) for name in EFFECTS}
    return PixelBlock(rng.standard_normal(len(NAMES)) + added, rows, sensor_known=True, names=NAMES)


def response(name: str, at_most: Array) -> Array:
    """In proportion to an effect's size, alike at all its places, [nodes, n]."""
    effect = get_effect(name)
    high = next(iter(effect.components.values())).high
    return at_all_places(effect, np.stack([size[SCALAR] / high * at_most for size in nodes(effect)]))


def _view(measured: Array, responses: Mapping[str, Array], matrix: Array) -> View:
    factor = np.linalg.cholesky(matrix)

    def whitened(rows: Array) -> Array:
        return np.asarray(solve_triangular(factor, rows.T, lower=True).T)

    shown = {name: whitened(rows) for name, rows in responses.items()}
    scatter = {"bending_hysteresis": whitened(np.kron(np.eye(REPEATS), np.outer([0.01, -0.01, 0.005], BULGE)))}
    return View(whitened(measured[None])[0], shown, scatter, factor, float(np.log(np.diag(factor)).sum()))
