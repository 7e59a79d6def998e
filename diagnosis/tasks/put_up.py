"""Set-ups as they are simulated; those that no cloth can be put up in are refused before any work."""

from __future__ import annotations

from collections.abc import Iterable

from capture.capture_set import Capture, CaptureSet
from diagnosis.tasks.meshing import cell_size, on_cells
from simcore.checks import check_request
from simcore.errors import InputError
from simcore.mesh import GridMesh
from simcore.scenes import Setup


def in_order(own: Iterable[Capture]) -> list[Capture]:
    """A fabric's captures: which cells they are simulated on, and which fold states one of them finds, depends on
    those before it, so that no file decides their order.
    """
    return sorted(own, key=lambda c: (c.scene.value, c.repeat, c.id))


def check_set_ups(captures: CaptureSet, resolution_m: float) -> None:
    """Refuse a set with a capture that cannot be simulated, whatever its picture shows.

    Args:
        captures: the set.
        resolution_m: wanted edge of a mesh cell.

    Raises:
        InputError: pins that cannot be, or a mesh that does not fit a sample.
    """
    for name in captures.fabrics:
        own = in_order(captures.of_fabric(name))
        if own:
            cell = cell_size(own[0].setup.sample_size_m, resolution_m)
            for capture in own:
                as_simulated(capture.id, capture.setup, cell)


def as_simulated(capture_id: str, setup: Setup, cell_m: float) -> Setup:
    """A set-up in whole cells.

    Args:
        capture_id: for messages.
        setup: as stated.
        cell_m: edge of a cell.

    Raises:
        InputError: naming the capture: it cannot be simulated.
    """
    try:
        whole = on_cells(setup, cell_m)
        check_request(GridMesh(cell_m, whole.sample_size_m), whole, None, None)
    except InputError as error:
        raise InputError(f"capture {capture_id}: {error}", code=error.code) from None
    return whole
