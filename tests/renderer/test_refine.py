"""Smooth surfaces through coarse grids."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from renderer.camera import CANONICAL_CAMERA, frontal_pose
from renderer.depth import render_depth
from renderer.refine import grid_shape, refine_grid
from renderer.shade import ShadedRenderer
from simcore.errors import InputError
from simcore.mesh import GridMesh

POSE = frontal_pose()


def ridges(mesh: GridMesh) -> NDArray[np.float64]:
    """Folds of 6 cm along the diagonal, as in the stretch scene [m]."""
    u, v = mesh.material_coordinates.T
    return np.stack([u - 0.25, -v, 0.02 + 0.008 * np.sin(2 * np.pi * (u - v) / (0.06 * np.sqrt(2)))], axis=1)


def test_the_grid_is_read_from_its_texture_coordinates() -> None:
    assert grid_shape(GridMesh(0.02).uv) == (26, 26)
    assert grid_shape(GridMesh(0.02, (0.5, 0.3)).uv) == (16, 26)
    assert grid_shape(np.zeros((9, 2))) is None
    assert grid_shape(np.random.default_rng(0).random((25, 2))) is None
    assert grid_shape(GridMesh(0.02).uv[:-1]) is None


@pytest.mark.parametrize("size", [(0.5, 0.5), (0.3, 0.5)])
def test_vertices_stay_and_triangles_keep_their_orientation(size: tuple[float, float]) -> None:
    mesh = GridMesh(0.02, size)
    vertices = ridges(mesh)
    surface = refine_grid(vertices, mesh.uv)
    factor = 4
    rows, columns = (mesh.rows - 1) * factor + 1, (mesh.columns - 1) * factor + 1
    kept = surface.vertices.reshape(rows, columns, 3)[::factor, ::factor].reshape(-1, 3)
    assert np.array_equal(kept, vertices)
    assert grid_shape(surface.uv) == (rows, columns)
    a, b, c = (surface.vertices[surface.triangles[:, k]] for k in range(3))
    assert np.all(np.cross(b - a, c - a)[:, 2] > 0)


def test_a_fine_grid_is_left_alone() -> None:
    mesh = GridMesh(0.005)
    surface = refine_grid(ridges(mesh), mesh.uv)
    assert np.array_equal(surface.vertices, ridges(mesh))
    assert np.array_equal(surface.triangles, mesh.triangles)


def test_depth_and_shading_come_closer_to_the_true_surface() -> None:
    """Truth: the same folds on a 2.5 mm mesh."""
    coarse, fine = GridMesh(0.01), GridMesh(0.0025)
    truth = render_depth(ridges(fine), fine.triangles, CANONICAL_CAMERA, POSE)
    facets = render_depth(ridges(coarse), coarse.triangles, CANONICAL_CAMERA, POSE)
    surface = refine_grid(ridges(coarse), coarse.uv)
    smooth = render_depth(surface.vertices, surface.triangles, CANONICAL_CAMERA, POSE)
    inner = (slice(60, 200), slice(60, 200))

    def rms(picture: NDArray[np.float32]) -> float:
        return float(np.sqrt(np.mean((picture - truth)[inner].astype(float) ** 2)))

    assert rms(smooth) < 0.35 * rms(facets)
    renderer, plain = ShadedRenderer(CANONICAL_CAMERA), ShadedRenderer(CANONICAL_CAMERA, smooth_cells=0)
    target = plain.render(ridges(fine), fine.triangles, fine.uv, POSE)[inner].astype(float)
    smoothed = renderer.render(ridges(coarse), coarse.triangles, coarse.uv, POSE)[inner] - target
    faceted = plain.render(ridges(coarse), coarse.triangles, coarse.uv, POSE)[inner] - target
    assert smoothed.std() < 0.4 * faceted.std()


def test_what_lies_on_the_panel_stays_before_it() -> None:
    mesh = GridMesh(0.02)
    vertices = ridges(mesh)
    vertices[:, 2] = np.maximum(vertices[:, 2] - 0.02, 0.0)
    assert refine_grid(vertices, mesh.uv).vertices[:, 2].min() == 0.0
    vertices[:, 2] -= 0.1
    assert refine_grid(vertices, mesh.uv).vertices[:, 2].min() < -0.1


def test_bad_input_is_refused() -> None:
    mesh = GridMesh(0.02)
    vertices = ridges(mesh)
    for bad, uv, code in (
        (vertices, np.zeros((len(vertices), 2)), "mesh_not_grid"),
        (vertices[:-1], mesh.uv, "mesh_not_grid"),
        (vertices * np.nan, mesh.uv, "mesh_not_finite"),
    ):
        with pytest.raises(InputError) as error:
            refine_grid(bad, uv)
        assert error.value.code == code
