"""Triangle meshes as the renderer takes them: checks and smooth normals."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simcore.errors import InputError


def check_surface(vertices: ArrayLike, triangles: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Vertices float64 [V, 3] and triangles int32 [T, 3], fit to be rendered or written.

    Raises:
        InputError: wrong shapes, vertices that are not finite, no triangle, or indices outside the vertices.
    """
    v = np.asarray(vertices, dtype=np.float64)
    t = np.asarray(triangles)
    if v.ndim != 2 or v.shape[1] != 3:
        raise InputError(f"vertices must have shape [vertices, 3], got {v.shape}", code="mesh_shape")
    if t.ndim != 2 or t.shape[1] != 3 or not np.issubdtype(t.dtype, np.integer):
        raise InputError(
            f"triangles must be whole numbers of shape [triangles, 3], got {t.dtype} {t.shape}", code="mesh_shape"
        )
    if t.shape[0] == 0:
        raise InputError("the mesh has no triangle: there is nothing to render", code="mesh_empty")
    if not np.all(np.isfinite(v)):
        bad = int(np.count_nonzero(~np.isfinite(v).all(axis=1)))
        raise InputError(
            f"{bad} of {len(v)} vertices are not finite: use only drapes whose status is 'still'",
            code="mesh_not_finite",
        )
    if t.min() < 0 or t.max() >= len(v):
        raise InputError(f"triangles point outside the {len(v)} vertices", code="mesh_indices")
    return v, t.astype(np.int32, copy=False)


def triangle_areas(vertices: NDArray[np.float64], triangles: NDArray[np.int32]) -> NDArray[np.float64]:
    """Normal of each triangle times twice its area [m²], float64 [T, 3]."""
    a, b, c = (np.take(vertices, triangles[:, corner], axis=0) for corner in range(3))
    first, second = b - a, c - a
    return np.stack(
        [
            first[:, 1] * second[:, 2] - first[:, 2] * second[:, 1],
            first[:, 2] * second[:, 0] - first[:, 0] * second[:, 2],
            first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0],
        ],
        axis=1,
    )


def vertex_normals(vertices: NDArray[np.float64], triangles: NDArray[np.int32]) -> NDArray[np.float64]:
    """Unit normals, area-weighted over the triangles at each vertex, float64 [V, 3].

    Summed in a fixed order, so that the same mesh gives the same bits. Vertices of no area get (0, 0, 1).
    """
    areas = triangle_areas(vertices, triangles)
    corners = triangles.T.ravel()
    normals: NDArray[np.float64] = np.stack(
        [np.bincount(corners, weights=np.tile(areas[:, k], 3), minlength=len(vertices)) for k in range(3)], axis=1
    )
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    flat = length[:, 0] < 1e-300
    normals[flat] = (0.0, 0.0, 1.0)
    length[flat] = 1.0
    normals /= length
    return normals
