"""The covariance of features, one error at a time, against what that error alone makes."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from diagnosis.inference.block import make_block
from diagnosis.inference.noise import UNMEASURED_LOG_NOISE, NoiseModel, feature_covariance
from tests.diagnosis.bare_capture import BARE_CELLS, BARE_LENGTH, bare_capture

NEVER_M = 1.0
SILENT = NoiseModel(
    floor_m=0.0,
    common_m=0.0,
    repeat_m=0.0,
    hanging_repeat_m=0.0,
    slide_m=0.0,
    share=0.0,
    contact_m=0.0,
    touching_m=0.0,
    pin_m=0.0,
    held_m=0.0,
    grip_share=0.0,
    grip_own_share=0.0,
    mesh_share=0.0,
    mesh_local=0.0,
    missed_m=NEVER_M,
    plane_m=0.0,
)
"""No error at all."""
NO_SIGMA = [0.0] * 7
NOISELESS = -400.0
"""Log of the noise of a pixel that has none."""
CELLS = slice(0, BARE_CELLS)
PLACES = np.array([[0.0, 0.0], [0.04, 0.0], [0.15, 0.0], *[[0.0, 5.0 * k] for k in range(1, 7)]])
"""Two cells at the correlation lengths from the first one; the others far from all."""
RNG_ROWS = np.random.default_rng(4).standard_normal((20, BARE_LENGTH))
"""Responses of all kinds: rows to take."""


def capture(scene: str = "stretch", pose: np.ndarray | None = None, rms_m: float = 0.001, **responses: Any) -> Any:
    """Without noise of pixels, flat on the panel, its cells at ``PLACES``; a third of them shows the panel alone."""
    made = bare_capture(rms_m, pose)
    made.scene = scene
    made.measured.pixels[:] = NOISELESS
    made.reference.centre = PLACES
    made.reference.slope = np.where(np.arange(BARE_CELLS) < 6, 0.2 + 0.1 * np.arange(BARE_CELLS), 0.0)
    for name, rows in responses.items():
        setattr(made.responses, name, rows)
    return made


def covariance(captures: list[Any], model: NoiseModel, sigma: list[float] = NO_SIGMA) -> np.ndarray:
    """By captures, [first, second, n, n]; checked to be one of something."""
    total = feature_covariance(captures, sigma, model)
    np.testing.assert_allclose(total, total.T, rtol=1e-12, atol=1e-24)
    assert np.linalg.eigvalsh(total).min() >= -1e-12 * max(np.abs(total).max(), 1e-30)
    count = len(captures)
    return total.reshape(count, BARE_LENGTH, count, BARE_LENGTH).transpose(0, 2, 1, 3)


def same(found: np.ndarray, expected: np.ndarray) -> None:
    """To rounding."""
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12 * max(float(np.abs(expected).max()), 1e-18))


def on_cells(values: np.ndarray) -> np.ndarray:
    """A covariance of the cells as one of the whole vector: the plane has no part in it."""
    whole = np.zeros((BARE_LENGTH, BARE_LENGTH))
    whole[CELLS, CELLS] = values
    return whole


def kernel(model: NoiseModel) -> np.ndarray:
    """How alike smooth errors are between cells."""
    distance = np.linalg.norm(PLACES[:, None] - PLACES[None], axis=2)
    parts = [np.exp(-0.5 * (distance / length) ** 2) for length in (model.length, model.short_length)]
    return np.asarray(0.5 * (parts[0] + parts[1]))


def own(first: np.ndarray, second: np.ndarray | None = None) -> np.ndarray:
    """Two repeats that share nothing."""
    nothing = np.zeros((BARE_LENGTH, BARE_LENGTH))
    return np.array([[first, nothing], [nothing, first if second is None else second]])


def shared(both: np.ndarray) -> np.ndarray:
    """Two repeats that err alike."""
    return np.array([[both, both], [both, both]])


def test_without_errors_there_is_no_covariance() -> None:
    full = capture(pins=RNG_ROWS[:8], mesh=RNG_ROWS[8], grip=RNG_ROWS[9], parameters=RNG_ROWS[10:17])
    assert not covariance([full, capture()], SILENT).any()


def test_the_floor_is_each_cell_s_own() -> None:
    found = covariance([capture(), capture()], replace(SILENT, floor_m=0.0003))
    same(found, own(on_cells(0.0003**2 * np.eye(BARE_CELLS))))


def test_noise_of_pixels_is_averaged_over_a_cell() -> None:
    one, other = capture(), capture()
    one.measured.pixels[0] = math.log(0.002)
    one.measured.weight[:] = np.arange(BARE_CELLS) ** 2  # of the first cell no pixel is seen
    other.measured.pixels[0] = np.nan
    found = covariance([one, other], SILENT)
    first = 0.002**2 / np.maximum(np.arange(BARE_CELLS) ** 2, 1)
    second = np.exp(2 * UNMEASURED_LOG_NOISE) / np.full(BARE_CELLS, 50.0)
    same(found, own(on_cells(np.diag(first)), on_cells(np.diag(second))))


def test_the_plane_errs_by_itself() -> None:
    found = covariance([capture(), capture()], replace(SILENT, plane_m=0.0004))
    same(found, own(np.diag(np.where(np.arange(BARE_LENGTH) < BARE_CELLS, 0.0, 0.0004**2))))


def test_what_simulators_differ_by_is_smooth_and_common_to_repeats() -> None:
    model = replace(SILENT, common_m=0.0002)
    found = covariance([capture(), capture()], model)
    same(found, shared(on_cells(0.0002**2 * kernel(model))))
    short, long = found[0, 1, 0, 1:3] / found[0, 1, 0, 0]
    assert short == pytest.approx(0.5 * (math.exp(-0.5) + math.exp(-0.5 * (0.04 / 0.15) ** 2)))
    assert long == pytest.approx(0.5 * math.exp(-0.5), abs=1e-3)


@pytest.mark.parametrize(("scene", "size_m"), [("stretch", 0.0002), ("hanging", 3.0 * 0.0007)])
def test_what_repeats_differ_by_is_each_one_s_own(scene: str, size_m: float) -> None:
    """In ``hanging`` a size of its own, times the factor."""
    model = replace(SILENT, repeat_m=0.0002, hanging_repeat_m=0.0007, hanging_factor=3.0)
    same(covariance([capture(scene)] * 2, model), own(on_cells(size_m**2 * kernel(model))))


@pytest.mark.parametrize(("scene", "factor"), [("stretch", 1.0), ("hanging", 2.5)])
@pytest.mark.parametrize("share", [0.0, 0.3])
def test_folds_that_slide_err_by_their_slope(scene: str, factor: float, share: float) -> None:
    model = replace(SILENT, slide_m=0.002, repeat_share=share, hanging_factor=2.5)
    one, other = capture(scene), capture(scene)
    other.reference.slope = other.reference.slope[::-1]
    found = covariance([one, other], model) / (factor * model.slide_m) ** 2
    slopes = [c.reference.slope for c in (one, other)]
    for a in range(2):
        for b in range(2):
            repeated = 1.0 + share**2 if a == b else 1.0
            same(found[a, b], on_cells(repeated * np.outer(slopes[a], slopes[b]) * kernel(model)))


@pytest.mark.parametrize(("scene", "factor"), [("stretch", 1.0), ("hanging", 2.5)])
def test_heights_err_by_a_share_of_themselves(scene: str, factor: float) -> None:
    model = replace(SILENT, share=0.02, repeat_share=0.3, hanging_factor=2.5)
    one, other = capture(scene), capture(scene)
    one.reference.height = 0.01 * np.arange(BARE_CELLS)
    other.reference.height = -0.02 * np.ones(BARE_CELLS)  # over the cloth's mean plane: some is below it
    found = covariance([one, other], model) / (factor * model.share) ** 2
    heights = [np.abs(c.reference.height) for c in (one, other)]
    for a in range(2):
        for b in range(2):
            repeated = 1.0 + 0.3**2 if a == b else 1.0
            same(found[a, b], on_cells(repeated * np.outer(heights[a], heights[b]) * kernel(model)))


@pytest.mark.parametrize("scene", ["stretch", "hanging"])
def test_all_cloth_stands_off_the_panel_together(scene: str) -> None:
    """However far its cells are from each other, and in all repeats; the panel beside it does not. Contact keeps cloth
    off as far in either scene."""
    cloth = np.arange(BARE_CELLS) < 6
    found = covariance([capture(scene), capture(scene)], replace(SILENT, contact_m=0.0008))
    same(found, shared(on_cells(0.0008**2 * np.outer(cloth, cloth))))


@pytest.mark.parametrize("scene", ["stretch", "hanging"])
def test_cloth_that_lies_on_the_panel_stands_off_by_more_the_nearer_it_is(scene: str) -> None:
    one, other = capture(scene), capture(scene)
    one.reference.height = np.linspace(0.0, 0.016, BARE_CELLS)
    other.reference.height = np.full(BARE_CELLS, -0.004)
    found = covariance([one, other], replace(SILENT, touching_m=0.0006, touch_m=0.004))
    cloth = np.arange(BARE_CELLS) < 6
    near = cloth * np.exp(-np.array([np.linspace(0.0, 4.0, BARE_CELLS), np.ones(BARE_CELLS)]))
    for a in range(2):
        for b in range(2):
            same(found[a, b], on_cells(0.0006**2 * np.outer(near[a], near[b])))


@pytest.mark.parametrize("scene", ["stretch", "hanging"])
def test_magnets_are_off_anew_in_every_repeat_and_hold_elsewhere_in_all(scene: str) -> None:
    pins = RNG_ROWS[:8]
    captures = [capture(scene, pins=pins), capture(scene, pins=pins)]
    moved = pins.T @ pins
    same(covariance(captures, replace(SILENT, pin_m=0.0005)), own(0.0005**2 * moved))
    same(covariance(captures, replace(SILENT, held_m=0.0003)), shared(0.0003**2 * moved))
    both = covariance(captures, replace(SILENT, pin_m=0.0005, held_m=0.0003))
    same(both, own(0.0005**2 * moved) + shared(0.0003**2 * moved))


@pytest.mark.parametrize(
    ("scene", "alike", "share"),
    [("stretch", False, 0.7), ("stretch", True, 0.03), ("hanging", False, 0.7), ("hanging", True, 0.7)],
)
def test_how_magnets_hold_is_uncertain_unless_it_is_looked_for(scene: str, alike: bool, share: float) -> None:
    model = replace(SILENT, grip_share=0.7, grip_own_share=0.03, grip_alike=alike)
    grip = RNG_ROWS[9]
    same(covariance([capture(scene, grip=grip)] * 2, model), shared(share**2 * np.outer(grip, grip)))


def test_a_share_of_the_coarser_mesh_s_change_is_the_fine_one_s_error() -> None:
    mesh = 0.001 * RNG_ROWS[8]
    found = covariance([capture(mesh=mesh)] * 2, replace(SILENT, mesh_share=0.3, mesh_most_m=NEVER_M))
    same(found, shared(0.3**2 * np.outer(mesh, mesh)))


@pytest.mark.parametrize("larger", [0.5, 1.0, 4.0])
def test_a_change_to_the_coarser_mesh_that_moves_folds_is_cut(larger: float) -> None:
    """Of the cells' root mean square; how far the plane moves does not count."""
    mesh = RNG_ROWS[8] / float(np.sqrt(np.mean(RNG_ROWS[8, CELLS] ** 2)))
    mesh[BARE_CELLS:] *= 100.0
    model = replace(SILENT, mesh_share=0.3, mesh_most_m=0.0015)
    kept = min(larger, 1.0) * 0.0015 * mesh
    found = covariance([capture(mesh=larger * 0.0015 * mesh), capture(mesh=mesh)], model)
    same(found[0, 0], 0.3**2 * np.outer(kept, kept))
    same(found[0, 1], 0.3**2 * np.outer(kept, 0.0015 * mesh))


@pytest.mark.parametrize("scene", ["stretch", "hanging"])
def test_the_mesh_errs_cell_by_cell_too(scene: str) -> None:
    """By the size of the change, whatever its sign; smooth, in all repeats and both scenes, cut as the rest."""
    mesh = 0.01 * np.abs(RNG_ROWS[8]) * (-1.0) ** np.arange(BARE_LENGTH)
    model = replace(SILENT, mesh_local=0.1, mesh_most_m=0.0015)
    size = np.abs(mesh[CELLS]) * 0.0015 / float(np.sqrt(np.mean(mesh[CELLS] ** 2)))
    same(
        covariance([capture(scene, mesh=mesh)] * 2, model),
        shared(on_cells(0.1**2 * np.outer(size, size) * kernel(model))),
    )


@pytest.mark.parametrize("common", [0.0, 0.5, 0.8, 1.0])
def test_a_pose_that_was_found_is_off_in_common_and_by_itself(common: float) -> None:
    pose = 0.001 * RNG_ROWS[:6]
    stated = capture()
    found = covariance([capture(pose=pose), capture(pose=2.0 * pose), stated], replace(SILENT, pose_common=common))
    whole = pose.T @ pose
    same(found[:2, :2], np.array([[whole, 2.0 * common * whole], [2.0 * common * whole, 4.0 * whole]]))
    assert not found[2].any()


def test_parameters_err_by_what_is_stated_of_them_in_all_repeats_alike() -> None:
    rows = 0.001 * RNG_ROWS[10:17]
    sigma = [0.07, 0.05, 0.0, 0.3, 0.2, 0.1, 0.02]
    found = covariance([capture(parameters=rows), capture(parameters=-rows)], SILENT, sigma)
    whole = sum(s**2 * np.outer(row, row) for s, row in zip(sigma, rows, strict=True))
    same(found, np.array([[whole, -whole], [-whole, whole]]))


def test_wrong_parameters_are_off_by_the_wide_share_but_for_the_density() -> None:
    """Beside the stated view a block has one in which the first six are worse known; what is worse still, stays so."""
    one = capture(parameters=0.001 * RNG_ROWS[10:17], effects={}, beside={}, probes={})
    one.fabric, one.id, one.warps = "f", "a", np.zeros((8, BARE_LENGTH))
    stated, wide = [0.07] * 4 + [0.9, 0.0, 0.02], [0.6] * 4 + [0.9, 0.6, 0.02]
    model = replace(SILENT, floor_m=0.0001, wide_sigma=0.6)
    block = make_block([one], stated, model)
    for view, sigma in ((block.stated, stated), (block.wide, wide)):
        same(view.factor @ view.factor.T, feature_covariance([one], sigma, model)[CELLS, CELLS])


@pytest.mark.parametrize(
    ("scene", "distances_mm", "noise_mm", "missed_mm"),
    [
        ("stretch", (2.0, 1.0), (0.0, 0.0), (math.sqrt(3.0), 0.0)),
        ("stretch", (1.0, 2.0), (0.0, 0.0), (0.0, math.sqrt(3.0))),
        ("stretch", (2.0, 1.0), (math.sqrt(3.0), 0.0), (0.0, 0.0)),  # a noisier sensor, no other folds
        ("stretch", (2.0, 1.5), (0.0, math.sqrt(1.25)), (math.sqrt(3.0), 0.0)),
        ("stretch", (1.0, 1.04), (0.0, 0.0), (0.0, 0.0)),
        ("stretch", (2.0, 2.0), (0.0, 0.0), (0.0, 0.0)),
        ("hanging", (2.0, 1.0), (0.0, 0.0), (0.0, 0.0)),
    ],
)
def test_a_capture_whose_folds_were_missed_is_wrong_by_what_it_is_further(
    scene: str, distances_mm: tuple[float, float], noise_mm: tuple[float, float], missed_mm: tuple[float, float]
) -> None:
    captures = [capture(scene, rms_m=1e-3 * far) for far in distances_mm]
    for one, noise in zip(captures, noise_mm, strict=True):
        one.noise_m2 = (1e-3 * noise) ** 2
    model = replace(SILENT, missed_m=0.0003, missed_length=0.08)
    distance = np.linalg.norm(PLACES[:, None] - PLACES[None], axis=2)
    cloth = np.arange(BARE_CELLS) < 6
    smooth = np.exp(-0.5 * (distance / 0.08) ** 2) * np.outer(cloth, cloth)
    same(covariance(captures, model), own(*(on_cells((1e-3 * missed) ** 2 * smooth) for missed in missed_mm)))


@pytest.mark.parametrize("scene", ["stretch", "hanging"])
@pytest.mark.parametrize("alike", [False, True])
def test_all_errors_together_add_up_and_leave_no_direction_without_one(scene: str, alike: bool) -> None:
    model = NoiseModel(grip_alike=alike)
    rng = np.random.default_rng(7)
    captures = []
    for rms_m in (0.001, 0.002, 0.0011):
        one = capture(scene, 0.001 * rng.standard_normal((6, BARE_LENGTH)), rms_m, pins=RNG_ROWS[:8])
        one.reference.height = 0.02 * rng.random(BARE_CELLS)
        one.responses.mesh, one.responses.grip = 0.003 * RNG_ROWS[8], 0.001 * RNG_ROWS[9]
        one.responses.parameters = 0.001 * RNG_ROWS[10:17]
        captures.append(one)
    total = feature_covariance(captures, [0.07] * 7, model)
    np.testing.assert_allclose(total, total.T, rtol=1e-12)
    assert np.linalg.eigvalsh(total).min() > 0.5 * model.floor_m**2
    silent = {name: getattr(SILENT, name) for name in ("missed_m", "pin_m", "held_m", "grip_share", "grip_own_share")}
    less = feature_covariance(captures, [0.07] * 7, replace(model, **silent))
    assert (np.diag(total) > np.diag(less)).all()
    assert np.linalg.eigvalsh(total - less).min() > -1e-12
