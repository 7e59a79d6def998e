"""Features of pictures whose differences are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.measurement.features import measure
from diagnosis.measurement.pixel_statistics import PIXEL_NAMES
from diagnosis.measurement.reference import CELLS, RING_CELLS, Reference, make_reference
from diagnosis.scene import SimulationScene
from diagnosis.synthesis import SET_CAMERA
from diagnosis.tasks.preparation import without_surroundings
from renderer.pose import invert_pose, transform_points
from renderer.sensor import SensorModel
from simcore.drape import Drape, DrapeStatus
from simcore.mesh import GridMesh
from simcore.scenes import Setup

SCENE = SimulationScene(Setup.nominal("stretch"), camera=SET_CAMERA)


def wavy(height_m: float = 0.02) -> Drape:
    """A sheet with one smooth fold before the panel."""
    mesh = GridMesh(0.02)
    u, v = mesh.material_coordinates.T
    z = 0.001 + height_m * np.sin(np.pi * u / 0.5) ** 2 * np.exp(-(((v - 0.2) / 0.1) ** 2))
    return Drape(mesh, np.stack([u - 0.25, -v, z], axis=1), DrapeStatus.STILL, 0.0, 0.0, True, 0, 0.0)


@pytest.fixture(scope="module")
def reference() -> Reference:
    return make_reference(wavy(), SCENE)


def test_cells_cover_the_cloth_and_a_strip_around_it(reference: Reference) -> None:
    found = np.unique(reference.cell)
    assert found.min() == -1
    assert set(range(CELLS * CELLS)) <= set(found.tolist())
    assert np.count_nonzero(reference.panel) > 20_000
    assert not np.any(reference.panel & (reference.cell >= 0))


def test_reference_against_itself_is_zero(reference: Reference) -> None:
    features = measure(reference.depth, reference)
    np.testing.assert_allclose(np.nan_to_num(features.vector()), 0.0, atol=1e-9)


def test_a_depth_bias_is_read_on_the_panel_alone(reference: Reference) -> None:
    features = measure((reference.depth + np.float32(0.005)).astype(np.float32), reference, with_pixels=False)
    np.testing.assert_allclose(features.plane, [0.005, 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(np.nan_to_num(features.shape), 0.0, atol=1e-6)


def test_cloth_that_stands_further_out_is_read_in_its_cells(reference: Reference) -> None:
    changed = make_reference(wavy(0.025), SCENE)
    shape = measure(changed.depth, reference, with_pixels=False).shape[: CELLS * CELLS].reshape(CELLS, CELLS)
    assert shape.min() == pytest.approx(-0.005, rel=0.1)  # nearer to the camera
    assert np.unravel_index(np.argmin(shape), shape.shape)[0] == int(0.2 / 0.5 * CELLS)


@pytest.mark.parametrize(
    ("sensor", "statistic", "least"),
    [
        (SensorModel(range_noise_m=0.002), "log_noise", 0.5),
        (SensorModel(range_noise_m=0.001, filter_px=1.0), "correlation", 0.3),
        (SensorModel(range_noise_m=0.001, quantisation_m=0.003), "log_step", 1.0),
        (SensorModel(range_noise_m=0.001, dropout=0.05), "dropout", 0.045),
    ],
)
def test_pixel_statistics_answer_their_mechanism(
    reference: Reference, sensor: SensorModel, statistic: str, least: float
) -> None:
    number = PIXEL_NAMES.index(statistic)

    def statistics(model: SensorModel) -> float:
        noisy = model.apply(reference.depth, np.random.default_rng(3))
        return float(measure(noisy, reference).pixels[number])

    change = statistics(sensor) - statistics(SensorModel(range_noise_m=0.001, quantisation_m=0.0002))
    assert change > least


def test_steps_finer_than_half_a_millimetre_count_as_continuous(reference: Reference) -> None:
    steps = []
    for quantisation_m in (0.0, 0.0002, 0.001, 0.003):
        noisy = SensorModel(range_noise_m=0.001, quantisation_m=quantisation_m).apply(
            reference.depth, np.random.default_rng(3)
        )
        steps.append(float(np.exp(measure(noisy, reference).pixels[PIXEL_NAMES.index("log_step")])))
    np.testing.assert_allclose(steps, [0.0005, 0.0005, 0.001, 0.003], rtol=0.01)


@pytest.mark.parametrize("dropout", [0.0, 0.05])
@pytest.mark.parametrize("behind_m", [0.0, 0.5, 1.6])
def test_what_lies_beyond_the_panels_border_changes_nothing(
    reference: Reference, behind_m: float, dropout: float
) -> None:
    """A panel that does not fill the picture, before nothing or a wall, or with things before its border."""
    points = transform_points(invert_pose(SCENE.camera_from_panel), SCENE.camera.back_project(reference.depth))
    within = (np.abs(points[..., 0]) <= 0.4) & (np.abs(points[..., 1] + 0.25) <= 0.35)
    small = np.where(within, reference.depth, np.float32(0.0))
    assert 0.1 < np.mean(small == 0.0) < 0.7
    sensor = SensorModel(range_noise_m=0.001, dropout=dropout)
    room = np.where(small > 0, small, np.float32(behind_m))
    seen, whole = (sensor.apply(z, np.random.default_rng(2), camera=SCENE.camera) for z in (room, reference.depth))
    cloth = (reference.cell >= 0) & (reference.cell < CELLS * CELLS)
    found = measure(without_surroundings(seen, cloth, SCENE), reference)
    full = measure(whole, reference)
    np.testing.assert_allclose(found.plane, full.plane, atol=1e-4)
    by_name = dict(zip(PIXEL_NAMES, found.pixels - full.pixels, strict=True))
    assert abs(by_name["log_noise"]) < 0.02
    assert abs(by_name["dropout"]) < 0.003
    np.testing.assert_allclose(found.shape, full.shape, atol=1e-3, equal_nan=True)


def test_without_a_panel_cloth_that_lies_elsewhere_leaves_no_holes() -> None:
    bare = SCENE.with_setup(Setup.nominal("stretch", panel=False))
    drape = wavy()
    reference = make_reference(drape, bare)
    shifted = np.roll(reference.depth, 6, axis=1)
    number = PIXEL_NAMES.index("dropout")
    assert measure(shifted, reference).pixels[number] == 0.0
    holes = SensorModel(dropout=0.05).apply(shifted, np.random.default_rng(1), camera=bare.camera)
    assert measure(holes, reference).pixels[number] == pytest.approx(0.05, abs=0.01)


def test_pixels_that_are_not_square_show_the_same_slopes_and_strip(reference: Reference) -> None:
    """A picture binned along the rows alone."""
    binned = replace(SET_CAMERA, fy=SET_CAMERA.fy / 2, cy=SET_CAMERA.cy / 2, height=SET_CAMERA.height // 2)
    found = make_reference(wavy(), replace(SCENE, camera=binned))
    cloth = slice(0, CELLS * CELLS)
    assert found.slope[cloth].mean() == pytest.approx(reference.slope[cloth].mean(), rel=0.05)
    for side in range(4):  # top, bottom, left, right
        cells = CELLS * CELLS + side * RING_CELLS + np.arange(RING_CELLS)
        one, other = (np.isin(r.cell, cells).sum() for r in (found, reference))
        assert one / other == pytest.approx(0.5, rel=0.12)
