"""What captures can tell apart is known from responses alone."""

from __future__ import annotations

from diagnosis.drape_cache import DrapeCache
from diagnosis.isolability import analyse, remedy
from tests.diagnosis.conftest import MakeSet

EFFECTS = ("air_draft", "depth_bias", "depth_scale", "pin_spacing", "range_noise")


def test_axial_errors_look_alike_and_others_do_not(make_set: MakeSet, shelf: DrapeCache) -> None:
    found = analyse(make_set(), EFFECTS, 0.02, shelf)
    confused = {(p.effect, p.other) for p in found.confused()}
    assert ("depth_bias", "depth_scale") in confused and ("depth_scale", "depth_bias") in confused
    assert ("air_draft", "pin_spacing") not in confused and ("range_noise", "depth_bias") not in confused
    assert found.invisible() == ()
    assert found.scenes == ("stretch",)
    pair = next(p for p in found.pairs if (p.effect, p.other) == ("depth_bias", "depth_scale"))
    assert pair.share < 0.1
    assert "distance" in remedy(pair)
