"""Fabrics with responses of random form, to ask what lies outside the catalogue."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from diagnosis.effect import SCALAR
from diagnosis.effects import get_effect
from diagnosis.inference.block import Block, PixelBlock, View
from diagnosis.inference.changes import line_forms, rim_forms
from diagnosis.inference.smooth_modes import smooth_modes
from diagnosis.measurement.reference import CELLS
from diagnosis.simulation.sizes import at_all_places, node_weights, nodes
from tests.diagnosis.response_rows import still_rows

EFFECTS = ("air_draft", "crease")
COUNT = CELLS * CELLS
ERROR_M = 0.0003
FABRICS = 4


def linear_responses(name: str, rng: np.random.Generator) -> np.ndarray:
    """Of random form at each place, as long as the size; three errors long at 0.5."""
    effect = get_effect(name)
    likeliest = int(np.sum(effect.place_shares == effect.place_shares.max()))
    forms = 6.0 * rng.standard_normal((likeliest, COUNT))
    others = np.random.default_rng([likeliest, len(effect.places)])  # what is drawn next is the same for any number
    forms = np.concatenate([forms, 6.0 * others.standard_normal((len(effect.places) - likeliest, COUNT))])
    sizes = np.array([node[SCALAR] for node in nodes(effect)])
    return at_all_places(effect, sizes[:, None] * np.repeat(forms, len(sizes) // len(forms), axis=0))


def fabrics(
    shown: Sequence[int], change: str | None, pins: Sequence[int] = (4,) * FABRICS, *, probed: bool = False
) -> list[Block]:
    """Fabrics with responses of random form, some of which show a change; errors of 0.3 mm.

    ``change``: an effect's name, "smooth" for a form that no effect has, of 1.2 mm, or a family of changes: "rim" for
    an edge that is lifted by 0.9 mm, "lines" for a fold down the middle as high, "picture" and "pins" for one
    of theirs; "weights" and "bends" for some of the probes, which are known where ``probed``.
    """
    rng = np.random.default_rng(7)
    form = 0.0012 * smooth_modes()[:COUNT] @ rng.standard_normal(smooth_modes().shape[1]) / 3.0
    blocks = []
    for fabric in range(FABRICS):
        rows = {name: linear_responses(name, rng) for name in EFFECTS}
        own = np.random.default_rng(100 + fabric)
        probes = {"weights": 1e-3 * own.standard_normal((4, COUNT)), "bends": 1e-3 * own.standard_normal((2, COUNT))}
        measured = rng.standard_normal(COUNT)
        moved = 0.3 * rng.standard_normal((pins[fabric], COUNT))
        owner, cell = np.zeros(COUNT, dtype=np.intp), np.arange(COUNT)
        parameters = 1e-4 * rng.standard_normal((7, COUNT))
        warps = 1e-4 * rng.standard_normal((8, COUNT))
        of_family = {
            "smooth": form,
            "rim": 0.0009 * rim_forms()[:COUNT, 0],
            "lines": 0.0009 * line_forms()[:COUNT, 2],
            "picture": 3.0 * warps[5],
            "pins": 0.001 * moved[2],
            "weights": 0.5 * probes["weights"][3],
            "bends": 0.3 * (probes["bends"][0] - probes["bends"][1]),
        }
        if fabric in shown and change in of_family:
            measured = measured + of_family[change] / ERROR_M
        elif fabric in shown and change is not None:
            measured = measured + node_weights(get_effect(change), {SCALAR: 0.3}) @ rows[change]
        view = View(measured, rows, {}, ERROR_M * np.eye(COUNT), COUNT * float(np.log(ERROR_M)))
        blocks.append(Block(f"f{fabric}", "stretch", ("a",), view, view, cell, owner, parameters, moved, warps))
        if probed:
            blocks[-1] = replace(blocks[-1], probes=probes)
    return blocks


def quiet(numbers: int = 1) -> PixelBlock:
    rows = {n: still_rows(n, numbers) for n in EFFECTS}
    return PixelBlock(np.zeros(numbers), rows, sensor_known=False)
