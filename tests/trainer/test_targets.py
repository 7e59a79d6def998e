from __future__ import annotations

import numpy as np
import pytest

from simcore.scenes import GRAVITY_M_S2
from trainer.config import Targets
from trainer.targets import TargetScaling, similarity_shift

RNG = np.random.default_rng(0)
PARAMETERS = np.exp(np.log([500, 400, 100, 2e-5, 1e-5, 1.5e-5, 0.2]) + RNG.normal(size=(50, 7)))


@pytest.mark.parametrize("targets", ["log", "log_per_weight"])
def test_decode_inverts_encode(targets: Targets) -> None:
    scaling = TargetScaling.fit(PARAMETERS, targets)
    encoded = scaling.encode(PARAMETERS)
    assert np.allclose(encoded.mean(axis=0), 0, atol=1e-12) and np.allclose(encoded.std(axis=0), 1)
    assert np.allclose(scaling.decode(encoded, PARAMETERS[:, 6]), np.log(PARAMETERS[:, :6]))
    assert TargetScaling.from_json(scaling.to_json()) == scaling


def test_over_the_weight_the_same_drape_has_the_same_targets() -> None:
    scaling = TargetScaling.fit(PARAMETERS, "log_per_weight")
    assert np.allclose(scaling.encode(PARAMETERS), scaling.encode(3.0 * PARAMETERS))


def test_similarity() -> None:
    """k / (rho g L) and B / (rho g L^3) are what a static drape shows; they must not change with the size."""
    k, b, density = 700.0, 3e-5, 0.2
    groups = k / (density * GRAVITY_M_S2 * 0.5), b / (density * GRAVITY_M_S2 * 0.5**3)
    shifted = np.exp(np.log([k, k, k, b, b, b]) + similarity_shift(0.3))
    assert shifted[0] / (density * GRAVITY_M_S2 * 0.3) == pytest.approx(groups[0])
    assert shifted[5] / (density * GRAVITY_M_S2 * 0.3**3) == pytest.approx(groups[1])
    assert not similarity_shift(0.5).any()


def test_densities_of_further_materials_are_known() -> None:
    scaling = TargetScaling.fit(PARAMETERS, "log_per_weight")
    heavy = PARAMETERS * 100.0
    known = scaling.knowing(heavy)
    assert known.density_high == pytest.approx(scaling.encode_density(heavy[:, 6]).max())
    assert known.density_high > scaling.density_high and known.density_low == scaling.density_low
    assert scaling.knowing(PARAMETERS) == scaling


def test_a_density_is_held_against_those_of_its_own_side() -> None:
    """The lightest training fabric is farther from the mean than the heaviest."""
    parameters = np.repeat(PARAMETERS[:1], 4, axis=0)
    parameters[:, 6] = [0.02, 0.3, 0.35, 0.4]
    scaling = TargetScaling.fit(parameters, "log")
    assert -scaling.density_low > 1.5 * scaling.density_high
    assert scaling.beyond(0.02) == pytest.approx(1.0) and scaling.beyond(0.0199) > 1.0 > scaling.beyond(0.021)
    heaviest = 0.4 if scaling.density_high > 1.0 else np.exp(scaling.density_mean + scaling.density_spread)
    assert scaling.beyond(heaviest) == pytest.approx(1.0) and scaling.beyond(1.01 * heaviest) > 1.0
    assert [scaling.beyond(end) for end in scaling.densities()] == pytest.approx([1.0, 1.0])
    assert TargetScaling.from_json(scaling.to_json()) == scaling
    earlier = {**scaling.to_json(), "density_limit": 2.0}
    assert TargetScaling.from_json(earlier).beyond(0.4) < 1.0  # which way was not kept
