"""The prior of fabrics: distribution, ranges, and samples that depend on their own index alone."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm, spearmanr

from simcore.bending import PlateRigidity
from simcore.errors import InputError
from simcore.parameters import PARAMETER_NAMES, FabricParameters
from simcore.prior import DEFAULT_RANGES, FabricPrior, check_ranges, is_admissible
from simcore.sampling import RandomDesign, SobolDesign

PRIOR = FabricPrior.default()
MANY = PRIOR.sample_array(range(4096), seed=5)


@settings(max_examples=25, deadline=None)
@given(st.lists(st.integers(0, 5000), min_size=1, max_size=12), st.integers(0, 2**31))
def test_a_sample_drawn_alone_equals_the_one_drawn_with_others(indices: list[int], seed: int) -> None:
    together = PRIOR.sample_array(indices, seed)
    for row, index in zip(together, indices, strict=True):
        assert np.array_equal(row, PRIOR.sample_array([index], seed)[0])


def test_a_far_index_is_cheap_and_the_same_either_way() -> None:
    design = SobolDesign(1)
    far = design.points(np.array([10_000_000, 10_000_001]), 0)
    design.points(np.array([3]), 0)  # backwards
    assert np.array_equal(far[1:], SobolDesign(1).points(np.array([10_000_001]), 0))


def test_a_used_design_travels_between_processes() -> None:
    design = SobolDesign(1)
    expected = design.points(np.arange(5), 0)
    buffers: list[pickle.PickleBuffer] = []
    packed = pickle.dumps(design, protocol=5, buffer_callback=buffers.append)
    shared = [bytes(buffer.raw()) for buffer in buffers]  # what comes through shared memory cannot be written to
    assert np.array_equal(pickle.loads(packed, buffers=shared).points(np.arange(5), 0), expected)


def test_seeds_differ_and_so_do_neighbours() -> None:
    assert not np.allclose(PRIOR.sample_array([0, 1], 0), PRIOR.sample_array([0, 1], 1))
    assert len(np.unique(MANY, axis=0)) == len(MANY)


def test_every_fabric_lies_in_the_ranges_and_is_a_stable_plate() -> None:
    low, high = np.array([DEFAULT_RANGES[name] for name in PARAMETER_NAMES]).T
    assert (low <= MANY).all() and (high >= MANY).all()
    assert is_admissible(MANY, margin=1.0999).all()


def test_an_inadmissible_plate_is_named_so() -> None:
    fabric = np.array([[100.0, 100.0, 50.0, 4e-5, 1e-5, 0.24e-5, 0.2], [100.0, 100.0, 50.0, 4e-5, 1e-5, 0.28e-5, 0.2]])
    assert is_admissible(fabric).tolist() == [False, True]  # 4 B_bias against 1.1 x 1e-5


@pytest.mark.parametrize("ratio", [1.0, 1.1, 1.5, 4.0])
def test_what_is_admissible_is_simulated_as_stated(ratio: float) -> None:
    """Warp and weft nearly alike leave a bias of next to nothing its margin, but no plate has it."""
    warp, weft = 1e-4 * ratio, 1e-4
    bias = np.linspace(1e-7, 4e-5, 400)
    fabrics = np.tile([100.0, 100.0, 50.0, warp, weft, 0.0, 0.2], (400, 1))
    fabrics[:, 5] = bias
    raised = np.array([PlateRigidity.of(FabricParameters.from_array(row)).bias_raised for row in fabrics])
    assert raised.any() and not raised.all()
    assert not is_admissible(fabrics)[raised].any()
    assert np.array_equal(is_admissible(fabrics, margin=1.0), ~raised)


def test_no_fabric_of_the_prior_is_another_for_that() -> None:
    assert all(not PlateRigidity.of(FabricParameters.from_array(row)).bias_raised for row in MANY)
    warp, weft, bias = MANY[:, 3:6].T
    assert ((4.0 * bias - warp - weft) / np.sqrt(warp * weft)).min() > -1.95


def test_marginals_are_the_measured_log_normal_cut_off() -> None:
    index = PARAMETER_NAMES.index("density")
    mean, std = PRIOR.log_mean[index], float(np.sqrt(PRIOR.log_cov[index][index]))
    low, high = np.log(DEFAULT_RANGES["density"])
    cut = norm.cdf([low, high], mean, std)
    expected = np.exp(norm.ppf(cut[0] + np.array([0.25, 0.5, 0.75]) * (cut[1] - cut[0]), mean, std))
    assert np.quantile(MANY[:, index], [0.25, 0.5, 0.75]) == pytest.approx(expected, rel=0.05)


def test_correlations_are_the_measured_ones(shared_dir: Path) -> None:
    joint = json.loads((shared_dir / "materials" / "measured.json").read_text())["joint_density_bending"]
    order = [3, 0, 1, 2]  # ours: bending warp, weft, bias, density
    wide = FabricPrior(PRIOR.log_mean, PRIOR.log_cov, dict.fromkeys(PARAMETER_NAMES, (1e-12, 1000000000000.0)))
    logs = np.log(wide.transform(SobolDesign(0).points(np.arange(8192), 0)))[:, 3:]
    by_source = np.asarray(joint["log_cov"])[np.ix_([1, 2, 3, 0], [1, 2, 3, 0])]
    assert np.cov(logs.T) == pytest.approx(by_source, rel=0.02)
    assert logs.mean(axis=0)[order] == pytest.approx(np.asarray(joint["log_mean"]), rel=0.005)


def test_stretch_is_correlated_among_its_three_directions() -> None:
    spearman = spearmanr(MANY).statistic
    assert spearman[0, 1] > 0.6 and spearman[0, 2] > 0.25 and spearman[1, 2] > 0.25
    assert np.abs(spearman[:3, 3:]).max() < 0.06


def test_sobol_spreads_more_evenly_than_chance() -> None:
    def spread(points: np.ndarray) -> float:
        return float(np.abs(points.mean(axis=0) - 0.5).max())

    indices = np.arange(512)
    assert spread(SobolDesign(0).points(indices, 0)) < 0.1 * spread(RandomDesign(0).points(indices, 0))


def test_random_design_is_addressable_too() -> None:
    alone = PRIOR.sample([7], design=RandomDesign(3))
    assert alone == PRIOR.sample(range(9), design=RandomDesign(3))[7:8] == PRIOR.sample([7], design=RandomDesign(3))


@pytest.mark.parametrize(
    ("ranges", "code"),
    [
        ({"density": (0.5, 0.1)}, "range_order"),
        ({"density": (0.3, 0.3)}, "range_order"),
        ({"density": (float("nan"), 0.1)}, "range_order"),
        ({"weight": (0.1, 0.5)}, "range_unknown"),
        ({"density": (100.0, 300.0)}, "range_limits"),
    ],
)
def test_unusable_ranges_are_refused(ranges: dict[str, tuple[float, float]], code: str) -> None:
    with pytest.raises(InputError) as raised:
        check_ranges(ranges)
    assert raised.value.code == code


def test_a_narrow_range_is_kept_to_or_refused() -> None:
    narrow = FabricPrior.default({"density": (0.19, 0.21)}).sample_array(range(50))
    assert ((narrow[:, 6] >= 0.19) & (narrow[:, 6] <= 0.21)).all()
    with pytest.raises(InputError) as raised:
        FabricPrior.default({"bending_warp": (1e-2, 2e-2)}).sample([0])
    assert raised.value.code == "ranges_empty"


@pytest.mark.parametrize("indices", [[-1], [0, 2**30]])
def test_an_index_outside_the_sequence_is_refused(indices: list[int]) -> None:
    with pytest.raises(InputError, match=f"outside 0 to {2**30 - 1}") as raised:
        PRIOR.sample(indices)
    assert raised.value.code == "index_out_of_range"
