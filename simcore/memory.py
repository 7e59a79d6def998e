"""Too little memory, told as what it is."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from simcore.errors import OutOfMemoryError
from simcore.mesh import GridMesh


@contextmanager
def memory_told(mesh: GridMesh) -> Iterator[None]:
    """What finds no memory on this mesh inside the block is an :class:`~simcore.errors.OutOfMemoryError`."""
    try:
        yield
    except MemoryError as error:
        raise OutOfMemoryError(
            f"out of memory on a mesh of {mesh.vertex_count} vertices ({str(error) or 'no more was to be had'}): use "
            "coarser cells, or run fewer processes side by side"
        ) from error
