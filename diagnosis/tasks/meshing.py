"""Square cells for a sample that was cut by hand."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product

from simcore.errors import InputError
from simcore.mesh import FEWEST_CELLS
from simcore.scenes import Setup

AS_CUT_M = 0.0005
"""A sample's edge is not known better than this [m]."""
MOST_CHANGED = 0.01
"""An edge may be simulated longer or shorter by this share."""
NEAR, FAR = 1.25, 2.0
"""A cell may be so many times larger or smaller than wanted."""
FINEST_M, COARSEST_M = 0.001, 0.1
COARSE_M = 0.025
"""Cells of twice the size are of use up to this size [m]."""


def check_resolution(wanted_m: float) -> None:
    """Refuse cells that no diagnosis can use.

    Raises:
        InputError: not a number from :data:`FINEST_M` to :data:`COARSEST_M`.
    """
    if not FINEST_M <= wanted_m <= COARSEST_M:
        raise InputError(
            f"resolution {wanted_m} m must be from {FINEST_M} to {COARSEST_M} m", code="resolution_out_of_range"
        )


def cell_size(size_m: tuple[float, float], wanted_m: float) -> float:
    """The square cell nearest to what is wanted, of those whole numbers of which fit both edges of a sample [m].

    They fit where both edges come out within half a millimetre; where none does, the one that fits best. A cell that
    is a quarter larger or smaller than wanted comes before one further off, which costs more or shows less. Of those
    that fit, fine ones come first that go into both edges an even number of times: cells of twice the size tell how
    far the mesh errs, and what changes little.

    Args:
        size_m: width and height of the sample.
        wanted_m: edge of a cell.

    Raises:
        InputError: a wanted cell out of range, or none between half and twice it fits both edges within a hundredth.
    """
    check_resolution(wanted_m)
    usable = [
        (max(0.0, misfit - AS_CUT_M), abs(math.log(cell / wanted_m)), cell)
        for cell in {*_candidates(size_m, wanted_m)}
        if FINEST_M <= cell <= COARSEST_M and (misfit := _misfit(size_m, cell)) <= MOST_CHANGED * min(size_m)
    ]
    near = [one for one in usable if one[1] <= math.log(NEAR)]
    found = near or [one for one in usable if one[1] <= math.log(FAR) + 1e-9]
    if not found:
        width, height = size_m
        raise InputError(
            f"no mesh of about {wanted_m} m fits a sample of {width:g} x {height:g} m: choose another resolution",
            code="resolution_does_not_divide",
        )
    even = [one for one in near if one[0] == 0.0 and 2 * one[2] <= COARSE_M and _even(size_m, one[2])]
    return min(even or found)[2]


def _even(size_m: tuple[float, float], cell_m: float) -> bool:
    return all(round(edge / cell_m) % 2 == 0 for edge in size_m)


def _candidates(size_m: tuple[float, float], wanted_m: float) -> list[float]:
    """Cells that divide one edge, or both as nearly as can be."""
    counts = [range(FEWEST_CELLS, math.ceil(FAR * edge / wanted_m) + 1) for edge in size_m]
    exact = [edge / count for edge, own in zip(size_m, counts, strict=True) for count in own]
    width, height = size_m
    between = [
        (width + height) / (columns + rows)  # off by the same length, one too long and one too short
        for columns, rows in product(*counts)
        if abs(width / columns - height / rows) < 2 * MOST_CHANGED * min(width / columns, height / rows)
    ]
    return exact + between


def _misfit(size_m: tuple[float, float], cell_m: float) -> float:
    """Length by which the worse edge comes out wrong [m]."""
    return max(abs(edge - max(round(edge / cell_m), FEWEST_CELLS) * cell_m) for edge in size_m)


def on_cells(setup: Setup, cell_m: float) -> Setup:
    """A set-up whose sample is made of whole cells; its pins move in proportion, so that the cloth is held as tight.

    Magnets that hold more than half a cell hold a whole one: cells of a sample of 503 mm are a little larger than
    10 mm, and a magnet of 10 mm that missed the next vertices would hold a point.

    Raises:
        InputError: an edge would change by more than a hundredth.
    """
    if 0.5 * cell_m < setup.pin_radius_m < cell_m:
        setup = replace(setup, pin_radius_m=cell_m * (1.0 + 1e-6))
    size = setup.sample_size_m
    whole = tuple(round(edge / cell_m) * cell_m for edge in size)
    if all(abs(edge / cell_m - round(edge / cell_m)) <= 1e-6 for edge in size):
        return setup
    if any(abs(new - edge) > MOST_CHANGED * edge for new, edge in zip(whole, size, strict=True)):
        raise InputError(
            f"a sample of {size[0]:g} x {size[1]:g} m does not fit the cells of {cell_m:.4g} m of its fabric's first "
            "capture: give samples of two sizes as two fabrics",
            code="resolution_does_not_divide",
        )
    across, down = whole[0] / size[0], whole[1] / size[1]
    pins = {name: (across * x, down * y, z) for name, (x, y, z) in setup.pins_m.items()}
    return replace(setup, sample_size_m=(whole[0], whole[1]), pins_m=pins)
