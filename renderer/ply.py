"""Drapes as binary PLY files (little endian, float64): the same drape gives the same bytes and nothing is rounded."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from renderer.atomic import write_atomically
from renderer.surface import check_surface
from simcore.errors import InputError

_FACE = np.dtype([("count", "u1"), ("corners", "<i4", (3,))])
_HEADER = """ply
format binary_little_endian 1.0
comment drapemeter: metres, panel frame
element vertex {vertices}
property double x
property double y
property double z
element face {faces}
property list uchar int vertex_indices
end_header
"""


@dataclass(frozen=True)
class PlyMesh:
    """A mesh read from a file: vertices float64 [V, 3] in metres, panel frame; triangles int32 [T, 3]."""

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int32]


def write_ply(path: Path | str, vertices: ArrayLike, triangles: ArrayLike) -> None:
    """Write a mesh, whole or not at all.

    Args:
        path: of the file.
        vertices, triangles: see :func:`ply_bytes`.

    Raises:
        InputError: the mesh is not fit or the file cannot be written.
    """
    write_atomically(path, ply_bytes(vertices, triangles))


def ply_bytes(vertices: ArrayLike, triangles: ArrayLike) -> bytes:
    """A mesh as it is in a file.

    Args:
        vertices: [m], panel frame, shape [V, 3].
        triangles: int, shape [T, 3].

    Raises:
        InputError: the mesh is not fit (see :func:`~renderer.surface.check_surface`).
    """
    v, t = check_surface(vertices, triangles)
    faces = np.empty(len(t), dtype=_FACE)
    faces["count"], faces["corners"] = 3, t
    header = _HEADER.format(vertices=len(v), faces=len(t)).encode("ascii")
    return header + v.astype("<f8").tobytes() + faces.tobytes()


def read_ply(path: Path | str) -> PlyMesh:
    """Read a mesh that :func:`write_ply` wrote.

    Raises:
        InputError: no such file, another kind of PLY, or cut off.
    """
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise InputError(f"cannot read mesh {path}: {error.strerror}", code="ply_missing") from error
    end = content.find(b"end_header\n")
    if not content.startswith(b"ply\n") or end < 0:
        raise InputError(f"{path} is not a PLY mesh", code="ply_unreadable")
    lines = content[:end].decode("ascii", errors="replace").splitlines()
    counts = [int(word) for line in lines if line.startswith("element ") and (word := line.split()[-1]).isdecimal()]
    expected = _HEADER.format(vertices=counts[0], faces=counts[1]).splitlines()[:-1] if len(counts) == 2 else None
    if expected is None or _essence(lines) != _essence(expected):
        raise InputError(
            f"{path} is another kind of PLY: drapes are little-endian triangles with vertices of type double",
            code="ply_unreadable",
        )
    body = content[end + len(b"end_header\n") :]
    split = counts[0] * 24
    if len(body) != split + counts[1] * _FACE.itemsize:
        raise InputError(f"{path} is damaged or cut off: {len(body)} bytes after the header", code="ply_unreadable")
    faces = np.frombuffer(body[split:], dtype=_FACE)
    if np.any(faces["count"] != 3):
        raise InputError(f"{path} has faces that are not triangles", code="ply_unreadable")
    v, t = check_surface(np.frombuffer(body[:split], dtype="<f8").reshape(-1, 3).copy(), faces["corners"].copy())
    return PlyMesh(v, t)


def _essence(lines: list[str]) -> list[str]:
    return [line for line in lines if not line.startswith(("comment", "obj_info"))]
