"""How far captures and simulations of the same thing may differ: the covariance of the features."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.measurement.reference import PLANE_NAMES
from diagnosis.tasks.fabric_task import CaptureResult

Array = NDArray[np.float64]
UNMEASURED_LOG_NOISE = -6.9
"""Of a pixel: where its noise cannot be measured it is taken for about 1 mm."""


@dataclass(frozen=True)
class NoiseModel:
    """Sizes of what is not in the simulation and yet no effect; lengths [m].

    Of the smooth errors, mesh and contact as sets with nothing in them have it, of this simulator and of others; among
    sizes that these allow, those that let most known effects be named (decision 025).

    Attributes:
        floor_m: error of a cell's mean that is independent of everything.
        common_m, repeat_m: smooth difference between simulators or meshes (the same in all repeats), and between
            repeats, where the cloth is flat.
        hanging_repeat_m: the latter in ``hanging``, before ``hanging_factor``.
        slide_m: shift of folds along the cloth's plane (common); times the slope it is a height.
        share: relative error of heights (common).
        repeat_share: share of the two that differs between repeats.
        contact_m: height at which contact keeps the cloth off the panel, uncertainty; all cloth stands off by it.
        touching_m, touch_m: the same for cloth that lies on the panel, fading over this height.
        pin_m: how far each magnet is from its stated place, along x and y; another draw in every repeat.
        held_m: how far the place at which a magnet holds the cloth differs from the simulated one (common).
        grip_share: share of the change between a magnet that holds a point and one that holds a patch (common to the
            repeats of a fabric).
        grip_own_share: the same of ``stretch`` where ``grip_alike``.
        grip_alike: what all fabrics share of it in ``stretch`` is looked for (:mod:`diagnosis.inference.holds`).
        mesh_share: share of the change to a mesh of twice the cell that is the fine mesh's own error, uncertainty.
        mesh_most_m: root mean square of that change beyond which folds moved, which refinement does not explain.
        mesh_local: the same cell by cell, smooth.
        hanging_factor: smooth differences, slides and shares of heights are so much larger in ``hanging``.
        length, short_length: correlation lengths of these errors, half of their variance each, in sample sizes.
        missed_m: a capture that is further from its fold state than another repeat, by more than this, shows folds that
            were not found: it is wrong by as much more, smoothly over ``missed_length``.
        pose_common: share of the variance of a pose found in the pictures that is the same in the repeats.
        plane_m: offset and change across the panel's picture: what a stated pose and sensor are good for.
        wide_sigma: relative uncertainty of a fabric whose stated parameters are simply wrong.
        pixel_sigma: of each pixel statistic with a stated sensor.
        calm_square: mean square of residuals in units of these errors where nothing is there, over that with the usual
            errors (:mod:`diagnosis.inference.larger`).
    """

    floor_m: float = 0.00003
    common_m: float = 0.00025
    repeat_m: float = 0.00004
    hanging_repeat_m: float = 0.0002
    slide_m: float = 0.0016
    share: float = 0.01
    repeat_share: float = 0.3
    contact_m: float = 0.0008
    touching_m: float = 0.0008
    touch_m: float = 0.004
    pin_m: float = 0.0005
    held_m: float = 0.0003
    grip_share: float = 0.7
    grip_own_share: float = 0.03
    grip_alike: bool = False
    mesh_share: float = 0.3
    mesh_most_m: float = 0.0015
    mesh_local: float = 0.1
    hanging_factor: float = 3.0
    length: float = 0.15
    short_length: float = 0.04
    missed_m: float = 0.0003
    missed_length: float = 0.08
    pose_common: float = 0.5
    plane_m: float = 0.0003
    wide_sigma: float = 0.6
    pixel_sigma: tuple[float, ...] = (0.02, 0.02, 0.1, 0.001, 0.03, 0.03, 0.03)
    calm_square: float = 1.0


def feature_covariance(captures: Sequence[CaptureResult], sigma: Sequence[float], model: NoiseModel) -> Array:
    """Covariance of the stacked shape-and-plane vectors of the repeats of one fabric in one scene [m²].

    Args:
        captures: the repeats.
        sigma: relative uncertainty of the seven parameters.
        model: the rest.
    """
    sizes = [c.reference.length for c in captures]
    held = np.concatenate([c.responses.pins for c in captures], axis=1) * model.held_m
    mesh = np.concatenate([_mesh_error(c, model) for c in captures]) * model.mesh_share
    alike = model.grip_alike and captures[0].scene == "stretch"
    grip = np.concatenate([c.responses.grip for c in captures])
    grip *= model.grip_own_share if alike else model.grip_share
    jacobian = np.vstack([stacked_jacobian(captures, sigma), held, mesh[None], grip[None]])
    total = jacobian.T @ jacobian
    poses = [np.zeros((6, size)) if c.pose is None else c.pose for c, size in zip(captures, sizes, strict=True)]
    together = np.concatenate(poses, axis=1)
    total += model.pose_common * together.T @ together
    starts = np.concatenate([[0], np.cumsum(sizes)])
    for a, first in enumerate(captures):
        for b, second in enumerate(captures):
            block = _smooth(first, second, model, same=a == b)
            total[starts[a] : starts[a] + len(block), starts[b] : starts[b] + block.shape[1]] += block
        missed = _missed(first, captures, model)
        total[starts[a] : starts[a] + len(missed), starts[a] : starts[a] + len(missed)] += missed
        own = slice(starts[a], starts[a + 1])
        pins = first.responses.pins * model.pin_m
        total[own, own] += pins.T @ pins + (1.0 - model.pose_common) * poses[a].T @ poses[a]
        plane = np.full(len(PLANE_NAMES), model.plane_m**2)
        diagonal = np.concatenate([model.floor_m**2 + sensor_variance(first), plane])
        total[own, own][np.diag_indices(sizes[a])] += diagonal
    return np.asarray(total)


def sensor_variance(capture: CaptureResult) -> Array:
    """Of each cell's mean, by the noise of its pixels [m²], [cells + ring]."""
    pixel = capture.measured.pixel_variance(UNMEASURED_LOG_NOISE)
    return np.asarray(pixel / np.maximum(capture.measured.weight, 1))


def stacked_jacobian(captures: Sequence[CaptureResult], sigma: Sequence[float]) -> Array:
    """Change of the stacked vectors for one standard deviation of each parameter [m], [7, n]."""
    return np.asarray(np.concatenate([c.responses.parameters for c in captures], axis=1) * np.asarray(sigma)[:, None])


def _smooth(first: CaptureResult, second: CaptureResult, model: NoiseModel, *, same: bool) -> Array:
    """Smooth model error between the cells of two captures."""
    a, b = first.reference, second.reference
    distance = np.linalg.norm(a.centre[:, None] - b.centre[None], axis=2)
    kernel = 0.5 * np.exp(-0.5 * (distance / model.length) ** 2)
    kernel += 0.5 * np.exp(-0.5 * (distance / model.short_length) ** 2)
    scale = model.hanging_factor if first.scene == "hanging" else 1.0
    repeat = (model.repeat_share**2 + 1.0) if same else 1.0
    own = model.hanging_repeat_m if first.scene == "hanging" else model.repeat_m
    flat = model.common_m**2 + (own**2 if same else 0.0)
    slide = model.slide_m**2 * np.outer(a.slope, b.slope) * repeat
    height = model.share**2 * np.outer(np.abs(a.height), np.abs(b.height)) * repeat
    cloth_a, cloth_b = a.slope > 0, b.slope > 0
    near_a, near_b = (cloth * np.exp(-np.abs(r.height) / model.touch_m) for cloth, r in ((cloth_a, a), (cloth_b, b)))
    contact = model.contact_m**2 * np.outer(cloth_a, cloth_b) + model.touching_m**2 * np.outer(near_a, near_b)
    mesh = model.mesh_local**2 * np.outer(
        _on_cells(first, _mesh_error(first, model)), _on_cells(second, _mesh_error(second, model))
    )
    return np.asarray(kernel * (scale**2 * (flat + slide + height) + mesh) + contact)


def _missed(capture: CaptureResult, repeats: Sequence[CaptureResult], model: NoiseModel) -> Array:
    """Of a capture whose folds no simulated state has although another repeat's were found."""
    reference = capture.reference
    alike = [c for c in repeats if c.setup == capture.setup]  # an effect shows otherwise in another set-up
    beyond = [c.rms_m**2 - c.noise_m2 for c in alike]  # repeats may be seen by several cameras
    further = capture.rms_m**2 - capture.noise_m2 - min(beyond)
    if further <= model.missed_m**2 or capture.scene == "hanging":
        return np.zeros((reference.count, reference.count))
    distance = np.linalg.norm(reference.centre[:, None] - reference.centre[None], axis=2)
    cloth = reference.slope > 0
    return np.asarray(further * np.exp(-0.5 * (distance / model.missed_length) ** 2) * np.outer(cloth, cloth))


def _mesh_error(capture: CaptureResult, model: NoiseModel) -> Array:
    """Change to the coarser mesh, cut where it is one of folds rather than of refinement."""
    change = capture.responses.mesh
    size = float(np.sqrt(np.mean(_on_cells(capture, change) ** 2)))
    return change * min(1.0, model.mesh_most_m / max(size, 1e-12))


def _on_cells(capture: CaptureResult, vector: Array) -> Array:
    """Absolute values of a shape-and-plane vector without the plane, [cells + ring]."""
    return np.abs(vector[: capture.reference.count])
