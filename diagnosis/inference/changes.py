"""Changes of which something outside the catalogue may be made up, by family; each is the same in all fabrics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from functools import cache

import numpy as np
from numpy.typing import NDArray

from diagnosis.effect import Effect, Stage
from diagnosis.effects import get_effect
from diagnosis.inference.block import Block, whiten
from diagnosis.inference.smooth_modes import smooth_modes
from diagnosis.measurement.reference import CELLS, cell_centres
from diagnosis.scene import SimulationScene
from diagnosis.simulation.probes import HOOKS
from diagnosis.simulation.sizes import node_values, nodes
from simcore.scenes import Scene, Setup

Array = NDArray[np.float64]
PARAMETER_SIGMAS, PIN_M, FORM_M = 3.0, 0.003, 0.003
"""Of a change of each parameter, of each pin along each axis, of each form of the cloth, of its rim or of a line across
it; effects: their typical size; warped pictures: :data:`diagnosis.simulation.warps.WARP`."""
LINES_AT, LINE_WIDTH = (1 / 4, 1 / 3, 1 / 2, 2 / 3, 3 / 4), 0.05
"""Where a folded sample has its folds, and how far the cloth beside one is raised, in sample sizes."""
DESCRIBED = {"pins": "placed", **{family: f"{family} described" for family in HOOKS}}
"""Of families, that of the same changes as effects of the catalogue make them: nothing unknown."""
FAMILIES = ("effects", "parameters", "picture", "pins", *HOOKS, "forms", "rim", "lines", *DESCRIBED.values())


def changes_of(effects: Sequence[str], blocks: Sequence[Block]) -> tuple[list[Array], dict[str, NDArray[np.intp]]]:
    """Changes of each block in units of its errors.

    Args:
        effects: names of the catalogue's effects that may take part.
        blocks: what was measured.

    Returns:
        Of each block a row for each change, [k, n]; of each of :data:`FAMILIES` the numbers of its rows.
    """
    usable = [e for e in map(get_effect, effects) if not (e.random_repeats or e.holds or e.white)]
    pins = {
        scene: {len(block.pins) for block in blocks if block.scene == scene}
        for scene in sorted({block.scene for block in blocks})
    }
    probes = {family: max(len(block.probes.get(family, ())) for block in blocks) for family in HOOKS}
    found = [_changes(usable, block, pins, probes) for block in blocks]
    ends = np.cumsum([len(found[0][family]) for family in FAMILIES])
    rows = dict(zip(FAMILIES, np.split(np.arange(ends[-1]), ends[:-1]), strict=True))
    return [np.concatenate([own[family] for family in FAMILIES]) for own in found], rows


def _changes(
    effects: Sequence[Effect], block: Block, pins: Mapping[str, Set[int]], probes: Mapping[str, int]
) -> dict[str, Array]:
    """Of one block.

    Args:
        effects: that may take part.
        block: see there.
        pins: by scene, how many rows its blocks have for their pins (left out where they differ).
        probes: how many rows blocks have of each family of probes; one that was not looked at shows none.
    """
    view = block.stated

    def by_scene(change: Array, counts: Mapping[str, int]) -> Array:  # another placement, other proportions
        own = whiten(view, change.T).T
        rows = [own if scene == block.scene else np.zeros((k, own.shape[1])) for scene, k in counts.items()]
        return np.concatenate([np.zeros((0, own.shape[1])), *rows])

    def typical(chosen: Sequence[Effect]) -> Array:
        return np.concatenate([np.zeros((0, len(view.measured))), *(_typical(e, view.responses) for e in chosen)])

    def probed(family: str) -> Array:
        own = block.probes.get(family)
        return np.zeros((probes[family], len(view.measured))) if own is None else whiten(view, own.T).T

    pin_moves = PIN_M * block.probes.get("pins", block.pins)
    alike = {scene: next(iter(counts)) for scene, counts in pins.items() if len(counts) == 1}
    forms, rims, lines = (FORM_M * own[block.cell].T for own in (smooth_modes(), rim_forms(), line_forms()))
    return {
        "effects": typical(effects),
        "parameters": whiten(view, PARAMETER_SIGMAS * block.jacobian.T).T,
        "picture": whiten(view, block.warps.T).T,
        "pins": by_scene(pin_moves, alike),
        "placed": whiten(view, (_placed(effects, block) @ pin_moves).T).T,
        "forms": by_scene(forms, dict.fromkeys(pins, len(forms))),
        "rim": by_scene(rims, dict.fromkeys(pins, len(rims))),
        "lines": by_scene(lines, dict.fromkeys(pins, len(lines))),
        **{family: probed(family) for family in HOOKS},
        **{DESCRIBED[family]: typical([e for e in effects if e.hook == hook]) for family, hook in HOOKS.items()},
    }


def _typical(effect: Effect, responses: Mapping[str, Array]) -> Array:
    """Response at a size in the middle of the prior, for each component (both ways) and each of its likeliest places.

    A row for each of many places would make up what none of them does.
    """
    known = responses[effect.name]
    if effect.vector:
        return known
    size = np.abs(node_values(effect))
    middle = int(np.argmin(np.abs(size - np.median(size))))
    likeliest = np.flatnonzero(effect.place_shares == effect.place_shares.max())
    return known[likeliest * len(size) + middle]


def _placed(effects: Sequence[Effect], block: Block) -> Array:
    """How the catalogue's effects move pins that move nothing else, the largest move being one, [moves, 2 pins]."""
    scenes = [SimulationScene(Setup.nominal(scene)) for scene in Scene]
    own = next(number for number, scene in enumerate(Scene) if scene.value == block.scene)
    found: list[Array] = []
    for effect in effects:
        for size in nodes(effect) if effect.stage is Stage.SETUP else []:
            changed = [effect.apply(scene, size) for scene in scenes]
            if any(c != scene.with_setup(c.setup) for c, scene in zip(changed, scenes, strict=True)):
                continue
            moves = [_pins(c) - _pins(scene) for c, scene in zip(changed, scenes, strict=True)]
            both = np.concatenate(moves)
            largest = both[np.argmax(np.abs(both))]
            if largest != 0.0 and not any(np.allclose(both / largest, other) for other in found):
                found.append(both / largest)
    start = sum(len(_pins(scene)) for scene in scenes[:own])
    rows = [move[start : start + len(_pins(scenes[own]))] for move in found]
    if any(len(row) != len(block.pins) for row in rows):
        return np.zeros((len(rows), len(block.pins)))
    return np.array(rows).reshape(len(rows), len(block.pins))


def _pins(scene: SimulationScene) -> Array:
    """Where the pins are, [2 pins]."""
    return np.array([place[:2] for place in scene.setup.pins_m.values()], dtype=np.float64).ravel()


@cache
def rim_forms() -> Array:
    """The outermost cells along each edge of the cloth raised alike, or more at one end, [cells + ring, 8]."""
    u, v = cell_centres().T
    cloth = np.arange(len(u)) < CELLS * CELLS
    edges = ((v * CELLS < 1, u), (v * CELLS > CELLS - 1, u), (u * CELLS < 1, v), (u * CELLS > CELLS - 1, v))
    return np.stack([cloth * edge * form for edge, along in edges for form in (np.ones_like(u), 2 * along - 1)], axis=1)


@cache
def line_forms() -> Array:
    """The cloth raised along a line down or across it, as a fold or a seam does, [cells + ring, 10]."""
    centres = cell_centres()
    cloth = np.arange(len(centres)) < CELLS * CELLS
    return np.stack([cloth * np.exp(-np.abs(c - at) / LINE_WIDTH) for c in centres.T for at in LINES_AT], axis=1)
