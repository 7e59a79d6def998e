"""Renders of drapes that were simulated before: drapes at hand, or a store."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from metric.draping import render_drape, render_vertices
from metric.render import DrapeRender
from renderer.store import RowStatus, Store
from simcore.drape import Drape
from simcore.errors import InputError
from simcore.mesh import GridMesh
from simcore.parameters import FabricParameters
from simcore.scenes import Scene

_SAMPLE_M = 0.5


@dataclass(frozen=True)
class StoredRenders:
    """One material of a store as the metric sees it.

    Attributes:
        fabric: its parameters.
        scenes: renders by scene, one a simulation that came to rest.
        failed: why each other simulation failed.
    """

    fabric: FabricParameters
    scenes: dict[Scene, list[DrapeRender]]
    failed: list[str]


def renders_from_drapes(drapes: Sequence[Drape]) -> list[DrapeRender]:
    """Renders of drapes at rest.

    Raises:
        InputError: a drape is not still.
    """
    moving = [k for k, drape in enumerate(drapes) if not drape.ok]
    if moving:
        first = drapes[moving[0]]
        raise InputError(
            f"drape {moving[0]} is not at rest ({first.status.value} {first.reason}): simulate it again with another "
            "seed, or leave it out",
            code="drape_not_still",
        )
    return [render_drape(drape) for drape in drapes]


def renders_from_store(store: Store, material: int) -> StoredRenders:
    """Renders of a material's stored drapes, frontal whatever the inclinations of the store's own pictures.

    Args:
        store: an opened store.
        material: index of the material.

    Raises:
        InputError: no such material, or a scene in which none of its simulations came to rest.
    """
    layout = store.layout
    if not 0 <= material < layout.materials:
        raise InputError(
            f"material {material} is not in the store: it holds 0 to {layout.materials - 1}", code="material_unknown"
        )
    mesh = _mesh(layout.vertex_count)
    scenes: dict[Scene, list[DrapeRender]] = {Scene.parse(name): [] for name in layout.scenes}
    failed: list[str] = []
    usable: list[int] = []
    for simulation in range(layout.simulations):
        found, place, jitter = layout.address(simulation)
        if found != material:
            continue
        row = simulation * layout.pictures
        status = RowStatus(int(store.status[row]))
        if store.ok[row]:
            usable.append(row)
            scenes[Scene.parse(layout.scenes[place])].append(render_vertices(store.vertices(simulation), mesh))
        else:
            why = "its shard is not finished" if status is RowStatus.OK else f"{status.label} {store.reason[row]}"
            failed.append(f"{layout.scenes[place]} {jitter}: {why}".strip())
    empty = [scene.value for scene, renders in scenes.items() if not renders]
    if empty:
        raise InputError(
            f"material {material} has no usable drape in {', '.join(empty)} ({'; '.join(failed)})",
            code="material_failed",
        )
    return StoredRenders(FabricParameters.from_array(store.parameters[usable[0]]), scenes, failed)


def _mesh(vertex_count: int) -> GridMesh:
    """The square mesh of so many vertices on the standard sample."""
    side = math.isqrt(vertex_count)
    if side * side != vertex_count:
        raise InputError(f"{vertex_count} vertices are no square grid", code="store_mesh")
    return GridMesh(_SAMPLE_M / (side - 1))
