"""What a simulation is refused for before anything is solved."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations

import numpy as np

from simcore.drape import Drape
from simcore.errors import InputError
from simcore.mesh import GridMesh
from simcore.number import is_number, shown
from simcore.scenes import Setup

LARGEST_PIN_STRETCH = 1.3
"""Two pins may be this many times as far apart as the cloth between them is long; beyond, any cloth tears."""

FARTHEST_PIN = 10.0
"""Pins lie within this many of the sample's diagonals of the panel's origin; beyond, the unit is another."""

_CORNERS = {"top_left": (0.0, 0.0), "top_right": (1.0, 0.0), "bottom_right": (1.0, 1.0)}


def seed_sequence(seed: int | Sequence[int] | np.random.SeedSequence) -> np.random.SeedSequence:
    """The seed of a drape's jitter as NumPy takes it.

    Raises:
        InputError: not whole numbers of 0 or more.
    """
    if isinstance(seed, np.random.SeedSequence):
        return seed
    try:
        if not _whole_numbers(seed):
            raise TypeError
        return np.random.SeedSequence(seed)
    except (TypeError, ValueError):
        raise InputError(f"seed {seed!r}: give a whole number of 0 or more, or several", code="seed_negative") from None


def _whole_numbers(seed: object) -> bool:
    """NumPy takes more: None for any seed at all, truth values for 0 and 1."""
    if isinstance(seed, Sequence | np.ndarray) and not isinstance(seed, str | bytes):
        return all(_whole_numbers(part) for part in seed)
    return isinstance(seed, int | np.integer) and not isinstance(seed, bool)


def check_request(mesh: GridMesh, setup: Setup, start: Drape | None, time_limit_s: float | None) -> None:
    """Check that a set-up, a drape to start from and a time limit can be used on a mesh.

    Raises:
        InputError: they cannot; the message says how to mend it.
    """
    if any(abs(a - b) > 1e-9 for a, b in zip(setup.sample_size_m, mesh.size_m, strict=True)):
        raise InputError(
            f"the mesh is for a sample of {mesh.size_m} m, the set-up has {setup.sample_size_m} m: "
            "make the mesh for the sample",
            code="mesh_mismatch",
        )
    if time_limit_s is not None and not (is_number(time_limit_s) and time_limit_s >= 0.0):
        raise InputError(f"time limit {shown(time_limit_s)} s must be 0 or more, or None for none", code="time_limit")
    check_pins(setup)
    if start is not None:
        _check_start(mesh, start)


def check_pins(setup: Setup) -> None:
    """Check that a sample can be held where a set-up's pins are.

    Raises:
        InputError: they lie behind the panel, far off, too far apart, in one place or crossed.
    """
    for name, place in setup.pins_m.items():
        if setup.panel and place[2] < 0.0:
            raise InputError(
                f"pin {name} at z = {place[2]:g} m is behind the panel: give z >= 0, or a set-up without a panel",
                code="pin_behind_panel",
            )
        reach = FARTHEST_PIN * math.hypot(*setup.sample_size_m)
        if math.hypot(*place) > reach:
            raise InputError(
                f"pin {name} is {math.hypot(*place):.3g} m from the panel's origin, more than {reach:.3g} m: "
                "give pin positions on the panel, in metres",
                code="pin_far",
            )
    size = np.asarray(setup.sample_size_m)
    for (a, place_a), (b, place_b) in combinations(setup.pins_m.items(), 2):
        cloth = float(np.linalg.norm((np.asarray(_CORNERS[a]) - _CORNERS[b]) * size))
        apart = math.dist(place_a, place_b)
        if apart > LARGEST_PIN_STRETCH * cloth:
            raise InputError(
                f"pins {a} and {b} are {apart:.3g} m apart, the cloth between them is {cloth:.3g} m long: "
                "give pin positions on the sample, in metres",
                code="pins_apart",
            )
        if apart < 2.0 * setup.pin_radius_m < cloth:
            raise InputError(
                f"pins {a} and {b} are {apart:.3g} m apart and hold {setup.pin_radius_m:g} m round them each: what two "
                "magnets hold cannot lie in one place: give pins farther apart, or a smaller pin radius",
                code="pins_overlap",
            )
    left, right = (setup.pins_m.get(name) for name in ("top_left", "top_right"))
    if left is not None and right is not None and left[0] >= right[0]:
        raise InputError(
            f"pin top_left at x = {left[0]:g} m is not left of top_right at x = {right[0]:g} m: give it the smaller x",
            code="pins_crossed",
        )
    bottom = setup.pins_m.get("bottom_right")
    if bottom is not None and right is not None and bottom[1] >= right[1]:
        raise InputError(
            f"pin bottom_right at y = {bottom[1]:g} m is not below top_right at y = {right[1]:g} m: y points up, give "
            "it the smaller y",
            code="pins_crossed",
        )


def _check_start(mesh: GridMesh, start: Drape) -> None:
    if start.mesh != mesh:
        raise InputError("a drape can only be continued on the mesh it was made on", code="mesh_mismatch")
    if start.vertices.shape != (mesh.vertex_count, 3):
        raise InputError(
            f"the drape to start from has vertices of shape {start.vertices.shape}, the mesh has {mesh.vertex_count}",
            code="mesh_mismatch",
        )
    if not np.isfinite(start.vertices).all():
        raise InputError(
            "the drape to start from has vertices that are not finite: start afresh", code="start_not_finite"
        )
