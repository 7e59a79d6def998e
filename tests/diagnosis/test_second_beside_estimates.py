"""What held-out captures say of a second effect where parameters are estimated from the captures (decision 048)."""

from __future__ import annotations

import pytest

from diagnosis.inference.cause import Cause
from diagnosis.shrinkage.held_out import Measured
from diagnosis.shrinkage.refutation import ESTIMATED_PAIR, NEEDED, judged
from tests.diagnosis.refutation_parts import left, two_effects


@pytest.mark.parametrize(
    ("first", "second", "both", "after", "probability"),
    [
        ("panel_tilt", "focal_scale", 0.9, 13.8, ESTIMATED_PAIR),  # a tilt, taken for a cloth that stretches otherwise
        ("panel_tilt", "focal_scale", 0.9, NEEDED * 10.74, ESTIMATED_PAIR),
        ("camera_rotation", "rest_curvature", 0.9, 9.0, 0.9),  # both are there
        ("edge_flying_pixels", "panel_tilt", 0.9, 13.8, ESTIMATED_PAIR),
        ("panel_tilt", "edge_flying_pixels", 0.9, 13.8, 0.9),  # no parameter shows in pixels
        ("panel_tilt", "focal_scale", 0.3, 13.8, 0.3),
    ],
)
def test_beside_estimated_parameters_a_second_effect_brings_held_out_captures_nearer(
    first: str, second: str, both: float, after: float, probability: float
) -> None:
    cause = two_effects(0.02, first, second, both)

    def measure(of: Cause, *, known: bool = False, **_: object) -> Measured:
        """Known to be there, two effects are fitted; sought again without a fabric they are others."""
        return Measured(left((5.0 if known else after) if len(of.named) == 2 else 10.74), ())

    kept, measured = judged(cause, measure, estimated=True)
    assert kept.pair_probability == pytest.approx(probability)
    assert kept.named == ((first, second) if probability > 0.5 else (first,))
    assert sum(kept.probabilities.values()) == pytest.approx(1.0)
    assert measured is not None and measured.shrinkage.after == (after if probability > 0.5 else 10.74)
    stated, _ = judged(cause, measure)
    assert stated.pair_probability == both
    unmeasured, _ = judged(cause, lambda of, **_: None, estimated=True)
    assert (len(unmeasured.named) == 2) is (second == "edge_flying_pixels")


def test_beside_estimated_parameters_two_effects_stay_where_neither_explains_the_captures_alone() -> None:
    """A turned camera and a curvature: alone each is less likely than something unknown."""
    cause = two_effects(0.09, "camera_rotation", "rest_curvature")
    kept, _ = judged(cause, lambda of, **_: Measured(left(3.0), ()), estimated=True)
    assert kept == cause


def test_what_shows_in_other_units_speaks_for_no_second_effect() -> None:
    def measure(of: Cause, **_: object) -> Measured:
        unit = "mm" if len(of.named) == 2 else "standard deviations"
        return Measured(left(1.0 if len(of.named) == 2 else 3.0).model_copy(update={"unit": unit}), ())

    kept, _ = judged(two_effects(0.02, "camera_rotation", "rest_curvature"), measure, estimated=True)
    assert kept.named == ("camera_rotation",)
