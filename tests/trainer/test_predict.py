from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

import trainer.predict
from capture.normalise import NetworkInput
from simcore.errors import InputError, MissingResourceError
from simcore.parameters import ESTIMATED_NAMES, FabricParameters
from simcore.scenes import Scene
from trainer.dataset import SCENES
from trainer.evaluate_captures import KnownFabric, evaluate_captures
from trainer.intervals import IntervalTable
from trainer.mirrored import mirror_reason
from trainer.model import TrainedModel
from trainer.predict import Estimate, Estimator

from .analytic import AnalyticSource


def _input(source: AnalyticSource, row: int, length_scale: float = 1.0) -> NetworkInput:
    scene = SCENES[int(source.table().scene[row])]
    small = source.read(np.array([row]))[0].numpy().astype(np.float32) * 1e-4
    height = np.kron(small, np.ones((4, 4), dtype=np.float32))
    return NetworkInput(height, np.ones_like(height, dtype=bool), scene, length_scale)


@pytest.fixture
def estimator(tiny_model: TrainedModel) -> Estimator:
    return Estimator(tiny_model)


def _row(source: AnalyticSource, scene: int, jitter: int = 0) -> int:
    table = source.table()
    return int(np.flatnonzero((table.material == 5) & (table.scene == scene) & (table.jitter == jitter))[0])


@pytest.mark.parametrize("scenes", [(0,), (1,), (0, 1)])
def test_any_subset_of_scenes(estimator: Estimator, analytic_source: AnalyticSource, scenes: tuple[int, ...]) -> None:
    inputs = {SCENES[s].value: _input(analytic_source, _row(analytic_source, s)) for s in scenes}
    density = float(analytic_source.table().parameters[_row(analytic_source, 0), 6])
    found = estimator.estimate(inputs, density)
    assert found.scenes == tuple(SCENES[s].value for s in scenes)
    FabricParameters(**found.parameters, density=density)  # positive, finite, within limits
    for name in ESTIMATED_NAMES:
        low, high = found.intervals_90[name]
        assert 0 < low < found.parameters[name] < high < math.inf
    assert not found.out_of_distribution and found.intervals_calibrated
    assert found.model_version == estimator.version


def test_repeats_are_averaged_over_every_combination(estimator: Estimator, analytic_source: AnalyticSource) -> None:
    rows = {scene: [_row(analytic_source, scene, jitter) for jitter in range(2)] for scene in range(2)}
    every = {SCENES[s]: [_input(analytic_source, row) for row in rows[s]] for s in range(2)}
    together = estimator.estimate(every, 0.2)
    single = [
        estimator.estimate({SCENES[0]: every[SCENES[0]][i], SCENES[1]: every[SCENES[1]][j]}, 0.2)
        for i in range(2)
        for j in range(2)
    ]
    for name in ESTIMATED_NAMES:
        expected = np.exp(np.mean([np.log(s.parameters[name]) for s in single]))
        assert together.parameters[name] == pytest.approx(expected, rel=1e-5)


def test_many_repeats_go_through_the_network_in_parts(
    estimator: Estimator, analytic_source: AnalyticSource, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = {scene: [_row(analytic_source, scene, jitter) for jitter in range(2)] for scene in range(2)}
    every = {SCENES[s]: [_input(analytic_source, row) for row in rows[s] * 3] for s in range(2)}
    together = estimator.estimate(every, 0.2)
    sizes: list[int] = []
    regress = Estimator._regress
    monkeypatch.setattr(trainer.predict, "PICTURES_AT_ONCE", 4)
    monkeypatch.setattr(trainer.predict, "COMBINATIONS_AT_ONCE", 5)
    monkeypatch.setattr(Estimator, "_regress", lambda self, c, d: (sizes.append(len(c)), regress(self, c, d))[1])
    parts = estimator.estimate(every, 0.2)
    assert sizes == [5] * 7 + [1]
    for name in ESTIMATED_NAMES:
        assert parts.parameters[name] == pytest.approx(together.parameters[name], rel=1e-5)
        assert parts.intervals_90[name] == pytest.approx(together.intervals_90[name], rel=1e-5)


def test_samples_of_another_size_are_converted(estimator: Estimator, analytic_source: AnalyticSource) -> None:
    row = _row(analytic_source, 0)
    nominal = estimator.estimate({"hanging": _input(analytic_source, row)}, 0.2)
    larger = estimator.estimate({"hanging": _input(analytic_source, row, length_scale=1.2)}, 0.2)
    assert larger.parameters["stretch_warp"] == pytest.approx(1.2 * nominal.parameters["stretch_warp"])
    assert larger.parameters["bending_bias"] == pytest.approx(1.2**3 * nominal.parameters["bending_bias"])
    assert larger.intervals_90["bending_bias"][1] == pytest.approx(1.2**3 * nominal.intervals_90["bending_bias"][1])


def test_samples_cut_a_millimetre_apart_are_seen_together(
    estimator: Estimator, analytic_source: AnalyticSource
) -> None:
    """As if both were of the size between them; not each scene by itself."""

    def seen(hanging: float, stretch: float) -> Estimate:
        sizes = (hanging, stretch)
        return estimator.estimate(
            {SCENES[s]: _input(analytic_source, _row(analytic_source, s), sizes[s]) for s in range(2)}, 0.2
        )

    together, mean = seen(1.0, 1.0), math.sqrt(1.0 * 1.002)
    apart = seen(1.0, 1.002)
    for name in ESTIMATED_NAMES:
        factor = mean ** (1 if name.startswith("stretch") else 3)
        assert apart.parameters[name] == pytest.approx(factor * together.parameters[name])
        assert apart.intervals_90[name] == pytest.approx([factor * end for end in together.intervals_90[name]])
    single = [
        estimator.estimate({SCENES[s]: _input(analytic_source, _row(analytic_source, s), size)}, 0.2)
        for s, size in enumerate((1.0, 1.05))
    ]
    for name in ESTIMATED_NAMES:
        expected = math.sqrt(single[0].parameters[name] * single[1].parameters[name])
        assert seen(1.0, 1.05).parameters[name] == pytest.approx(expected)


@pytest.mark.parametrize(
    ("sizes", "groups"),
    [
        ([1.0], [[1.0]]),
        ([1.0, 1.03], [[1.0, 1.03]]),
        ([1.0, 1.031], [[1.0], [1.031]]),
        ([1.0, 1.025, 1.035], [[1.0], [1.025, 1.035]]),
        ([0.6, 0.61, 1.0, 1.02, 1.2], [[0.6, 0.61], [1.0, 1.02], [1.2]]),
    ],
)
def test_sizes_that_agree_are_one_group(sizes: list[float], groups: list[list[float]]) -> None:
    assert trainer.predict._alike(sizes) == groups


@pytest.mark.parametrize("fused", [True, False])
def test_calibrated_is_what_the_sets_of_scenes_are_that_were_used(
    fused: bool, tiny_model: TrainedModel, analytic_source: AnalyticSource
) -> None:
    """Scenes of samples of very different sizes are not fused: each has its own intervals."""
    factors = {key: (1.0 if ("+" in key) == fused else math.inf,) * 6 for key in tiny_model.intervals.factors}
    estimator = Estimator(replace(tiny_model, intervals=IntervalTable(factors, {})))
    for size, together in ((1.0, True), (1.002, True), (1.2, False)):
        inputs = {SCENES[s]: _input(analytic_source, _row(analytic_source, s), (1.0, size)[s]) for s in range(2)}
        assert estimator.estimate(inputs, 0.2).intervals_calibrated == (together == fused)


def test_what_is_unlike_the_training_pictures_is_flagged(estimator: Estimator, analytic_source: AnalyticSource) -> None:
    row = _row(analytic_source, 0)
    known = _input(analytic_source, row)
    crumpled = np.abs(np.random.default_rng(0).normal(0.1, 0.1, known.height.shape)).astype(np.float32)
    assert estimator.estimate({"hanging": replace(known, height=crumpled)}, 0.2).out_of_distribution
    # Equalisation hides the height from the network; the statistics do not.
    assert estimator.estimate({"hanging": replace(known, height=20 * known.height)}, 0.2).out_of_distribution
    heavy = estimator.estimate({"hanging": known}, 4.9)
    assert heavy.out_of_distribution and heavy.out_of_distribution_score > 1


def test_a_density_beyond_those_of_the_training_is_told_apart_from_the_pictures(
    estimator: Estimator, analytic_source: AnalyticSource
) -> None:
    shown = {"hanging": _input(analytic_source, _row(analytic_source, 0))}
    _, high = estimator.model.scaling.densities()
    known, heavy = estimator.estimate(shown, 0.99 * high), estimator.estimate(shown, 1.2 * high)
    assert known.reasons == () and not known.out_of_distribution
    assert heavy.picture_score == known.picture_score < 1.0 < heavy.out_of_distribution_score
    (reason,) = heavy.reasons
    assert reason.startswith(f"the density {1.2 * high:g} kg/m² is beyond the ") and f"to {high:.2g} that" in reason


def test_without_calibration_the_interval_is_the_training_range(
    tiny_model: TrainedModel, analytic_source: AnalyticSource
) -> None:
    unknown = IntervalTable(dict.fromkeys(tiny_model.intervals.factors, (math.inf,) * 6), {})
    estimator = Estimator(replace(tiny_model, intervals=unknown))
    found = estimator.estimate({"hanging": _input(analytic_source, _row(analytic_source, 0))}, 0.2)
    low, high = found.intervals_90["bending_warp"]
    expected = 4 * tiny_model.scaling.spread[3]
    assert math.log(high / low) >= expected - 1e-9
    assert not found.intervals_calibrated


def test_bad_input(estimator: Estimator, analytic_source: AnalyticSource) -> None:
    good = _input(analytic_source, _row(analytic_source, 0))
    nothing = replace(good, height=np.zeros_like(good.height))
    cases = [
        ({}, 0.2, "no_captures"),
        ({"hanging": []}, 0.2, "no_captures"),
        ({"lying": good}, 0.2, "scene_unknown"),
        ({"hanging": nothing}, 0.2, "no_cloth"),
        ({"hanging": good}, math.nan, "parameter_out_of_range"),
        ({"hanging": good}, 200.0, "parameter_out_of_range"),
        ({"hanging": good}, -0.2, "parameter_out_of_range"),
    ]
    for inputs, density, code in cases:
        with pytest.raises(InputError) as caught:
            estimator.estimate(inputs, density)
        assert caught.value.code == code


def test_a_picture_without_cloth_is_named(estimator: Estimator, analytic_source: AnalyticSource) -> None:
    good = _input(analytic_source, _row(analytic_source, 0))
    nothing = replace(good, height=np.zeros_like(good.height))
    inputs = {"hanging": [good, nothing, good]}
    told = "picture 2 of 3 of hanging shows no cloth before the panel: check"
    with pytest.raises(InputError, match=f"^{told}"):
        estimator.estimate(inputs, 0.2)
    with pytest.raises(InputError, match=f"^fabric 'f2': {told}") as caught:
        estimator.estimate_named("f2", inputs, 0.2)
    assert caught.value.code == "no_cloth"
    known = [KnownFabric(name, 0.2, np.ones(6), {Scene.HANGING: shown}) for name, shown in (("a", [good]), ("b", []))]
    with pytest.raises(InputError, match=r"^fabric 'b': no capture to estimate from"):
        evaluate_captures(estimator, known)


def test_without_a_default_model_the_error_says_how_to_get_one(
    monkeypatch: pytest.MonkeyPatch, tmp_path: object
) -> None:
    monkeypatch.setattr(trainer.predict, "DEFAULT_MODEL", tmp_path)
    with pytest.raises(MissingResourceError, match=r"drapemeter train --store.*give --model") as caught:
        Estimator.load()
    assert caught.value.code == "default_model_missing"


def test_pixels_without_knowledge_are_background(estimator: Estimator, analytic_source: AnalyticSource) -> None:
    good = _input(analytic_source, _row(analytic_source, 1))
    cloth = good.height > 0
    filled = replace(good, height=np.where(cloth, good.height, np.float32(9.9)), mask=cloth)
    a, b = (estimator.estimate({Scene.STRETCH: i}, 0.2) for i in (good, filled))
    assert a == b
    assert torch.is_grad_enabled()


def test_a_set_up_that_no_network_was_shown_is_told(estimator: Estimator, analytic_source: AnalyticSource) -> None:
    shown = _input(analytic_source, _row(analytic_source, 0))
    plain = estimator.estimate({SCENES[0]: shown}, 0.2)
    odd = estimator.estimate({SCENES[0]: replace(shown, otherwise=("pins are elsewhere",))}, 0.2)
    assert odd.out_of_distribution and odd.reasons == ("pins are elsewhere",)
    assert odd.parameters == plain.parameters and plain.reasons == ()


def test_stretch_alone_is_looked_at_in_the_mirror_which_sets_no_parameter(
    estimator: Estimator, analytic_source: AnalyticSource, monkeypatch: pytest.MonkeyPatch
) -> None:
    inputs = {SCENES[s]: _input(analytic_source, _row(analytic_source, s)) for s in range(2)}
    plain = estimator.estimate(inputs, 0.2)
    monkeypatch.setattr(trainer.predict, "fits_better_in_the_mirror", lambda own, mirrored: np.ones(len(own), bool))
    told = estimator.estimate(inputs, 0.2)
    assert plain.reasons == () and not plain.out_of_distribution
    assert told.reasons == (mirror_reason(Scene.STRETCH, [True]),) and told.out_of_distribution
    assert replace(told, reasons=(), out_of_distribution=False) == plain
