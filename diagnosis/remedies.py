"""What would separate two effects that captures cannot tell apart."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType

from diagnosis.effects import get_effect
from diagnosis.isolability import Isolability
from diagnosis.separation import SEPARABLE_NATS

KNOWN: Mapping[frozenset[str], str] = MappingProxyType(
    {
        frozenset({"depth_scale", "depth_bias"}): "capture a set of its own from another distance and compare the "
        "sizes: a bias stays, what a scale does grows with the distance",
        frozenset({"depth_scale", "camera_translation"}): "capture a set of its own from another distance and compare "
        "the sizes: a moved camera stays, what a scale does grows with the distance",
        frozenset({"depth_bias", "camera_translation"}): "measure the camera's distance",
        frozenset({"depth_scale", "focal_scale"}): "capture a set of its own from another distance and compare what it "
        "names",
        frozenset({"air_draft", "panel_tilt"}): "add fabrics of other weight, or lay a level on the panel",
        frozenset({"pin_drop", "camera_rotation"}): "show the camera the bare panel with a plumb line",
    }
)
"""From what the effects are: these captures need not be simulated for it."""
MOST_TIMES = 4
"""More fabrics than this many times those at hand are no advice."""


def remedy(effect: str, other: str, found: Isolability | None = None) -> str:
    """What would separate two effects, in words.

    Known pairs first, then the scene that the captures lack where it was simulated and tells them apart, then more of
    the same where that is enough by the evidence that each capture adds, then what the effects' stages ask for.

    Args:
        effect: that is there.
        other: that explains it nearly as well.
        found: the analysis that could not tell them apart, where there is one.
    """
    pair = frozenset({effect, other})
    if pair in KNOWN:
        return KNOWN[pair]
    if found is not None:
        lacking = [s for s, nats in found.by_scene.items() if s not in found.scenes and _enough(nats, effect, other)]
        if lacking:
            return f"capture in {' or '.join(lacking)}, too"
        nats = next((p.nats for p in found.pairs if (p.effect, p.other) == (effect, other)), 0.0)
        if SEPARABLE_NATS / MOST_TIMES <= nats < SEPARABLE_NATS:
            return f"about {math.ceil(SEPARABLE_NATS / nats)} times as many fabrics"
    return _by_stage({get_effect(effect).stage.value, get_effect(other).stage.value})


def _enough(nats: Mapping[tuple[str, str], float], effect: str, other: str) -> bool:
    return nats.get((effect, other), 0.0) >= SEPARABLE_NATS


def _by_stage(stages: set[str]) -> str:
    if "setup" in stages:
        return "measure where the magnets sit, and capture once more with another pin distance"
    if "fabric" in stages:
        return "capture once more with the sample turned by a quarter"
    if "environment" in stages:
        return "capture once more in still air, and with the panel wiped with an antistatic cloth"
    if "camera" in stages:
        return "capture a set of its own from another distance and angle, and compare what it names"
    return "record the bare panel several times: what changes between the pictures is the sensor's"
