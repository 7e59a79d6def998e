"""Where what is left over and is common to all fabrics is answered as `unknown`, and where an effect explains it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from diagnosis.effect import SCALAR
from diagnosis.effects import get_effect
from diagnosis.inference.block import PixelBlock
from diagnosis.inference.cause import name_cause
from diagnosis.inference.evidence import tabulate_nothing
from diagnosis.inference.likelihood import LikelihoodModel, some_off
from diagnosis.inference.remainder import Mixture
from diagnosis.inference.said_again import is_said_again
from diagnosis.inference.something_beside import something_beside
from diagnosis.inference.subtract import pixels_without, responses_at_place
from diagnosis.inference.unknown import tabulate_unknown, without_repeated
from diagnosis.measurement.reference import PLANE_NAMES
from diagnosis.simulation.sizes import node_weights, nodes
from tests.diagnosis.remainder_parts import COUNT, EFFECTS, FABRICS, fabrics, quiet
from tests.diagnosis.response_rows import still_rows


@pytest.mark.parametrize("family", ["rim", "lines", "picture", "pins"])
def test_what_few_changes_find_in_all_fabrics_is_unknown(family: str) -> None:
    assert name_cause(EFFECTS, fabrics(range(FABRICS), family), quiet()).top == "unknown"


def test_what_no_effect_describes_is_unknown() -> None:
    assert name_cause(EFFECTS, fabrics(range(FABRICS), "smooth"), quiet()).top == "unknown"


def test_an_effect_of_the_catalogue_leaves_nothing_over() -> None:
    cause = name_cause(EFFECTS, fabrics(range(FABRICS), "air_draft"), quiet())
    assert cause.named == ("air_draft",) and cause.probabilities["unknown"] < 0.1


@pytest.mark.parametrize(
    ("alone", "left", "gained", "again"),
    [
        (20.0, -3.0, 15.0, True),  # the effect explains it
        (20.0, 5.0, 15.0, True),  # nearly all of it
        (20.0, 10.0, 15.0, False),  # half of it is left over
        (20.0, -3.0, 6.0, False),  # granted any size it would, at its own it gains little
        (-2.0, -3.0, 1.0, False),  # there is nothing to explain
    ],
)
def test_a_mixture_that_says_what_an_effect_says_is_nothing_unknown(
    alone: float, left: float, gained: float, again: bool
) -> None:
    assert is_said_again(alone, left, gained) is again


@pytest.mark.parametrize("alone", [60.0, 20.0])
@pytest.mark.parametrize(("left_by_both", "unknown"), [(-5.0, False), (30.0, True)])
def test_what_two_effects_say_together_is_nothing_unknown(
    alone: float, left_by_both: float, unknown: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A mixture that gains much, and 40 nats beside either effect, counts only if both together leave it much, too."""
    size = {SCALAR: 1.0, **get_effect("crease").places[0]}
    blocks = []
    for block in fabrics(range(FABRICS), "air_draft"):
        crease = node_weights(get_effect("crease"), size) @ block.stated.responses["crease"]
        view = replace(block.stated, measured=block.stated.measured + crease)
        blocks.append(replace(block, stated=view, wide=view))
    of_one = {len(responses_at_place(blocks[0].stated.responses, name, size)) for name in EFFECTS}

    def gain(self: Mixture, left: object, granted: Sequence[np.ndarray]) -> np.ndarray:
        count = len(granted[0])
        nats = alone if not count else 40.0 if count in of_one else left_by_both
        return np.full(len(self.families), nats)

    monkeypatch.setattr(Mixture, "gain", gain)
    cause = name_cause(EFFECTS, blocks, quiet())
    assert (cause.top == "unknown") is unknown
    assert unknown or set(cause.named) == set(EFFECTS)


def test_shared_numbers_that_contradict_an_effect_speak_for_something_unknown() -> None:
    pixels = quiet(len(PLANE_NAMES))
    off = PixelBlock(np.full(len(PLANE_NAMES), 40.0), pixels.responses, sensor_known=False)
    blocks = fabrics(range(FABRICS), "air_draft")
    assert name_cause(EFFECTS, blocks, pixels).named == ("air_draft",)
    assert name_cause(EFFECTS, blocks, off).top == "unknown"


@pytest.mark.parametrize(("by_first", "by_second", "named"), [(0.0, 0.0, ()), (8.0, 0.0, (1,)), (0.0, 8.0, (1, 2))])
def test_a_number_that_no_named_effect_changes_is_something_unknown(
    by_first: float, by_second: float, named: tuple[int, ...]
) -> None:
    """One number is off by 8 deviations beside an effect that is sure: nothing of that is granted to an effect that
    cannot change it; an effect that does, or a second one that does, explains it."""
    blocks = fabrics(range(FABRICS), "air_draft")
    rows = {n: still_rows(n, len(PLANE_NAMES)) for n in (*EFFECTS, "dropout")}
    for block in blocks:
        block.stated.responses["dropout"] = np.zeros((len(rows["dropout"]), COUNT))
    rows["air_draft"][:, 2] = by_first
    rows["dropout"][:, 2] = by_second
    off = PixelBlock(np.array([0.0, 0.0, 8.0]), rows, sensor_known=False)
    cause = name_cause((*EFFECTS, "dropout"), blocks, off)
    assert set(cause.named) == {("", "air_draft", "dropout")[n] for n in named}
    assert named or cause.top == "unknown"


def test_numbers_that_an_effect_explains_say_nothing_unknown() -> None:
    """Of what they say for something unknown alone, no more than what the effect gains, and what it leaves, stays."""
    blocks, model = fabrics(range(0), None), LikelihoodModel()
    rows = {n: still_rows(n, len(PLANE_NAMES)) for n in EFFECTS}
    rows["air_draft"][:, 2] = 80.0
    pixels = PixelBlock(np.array([0.0, 0.0, 80.0]), rows, sensor_known=False)
    evidence = dict(name_cause(EFFECTS, blocks, pixels, model, pairs=False).evidence)
    nothing, numbers = evidence["none"].log_evidence, some_off(pixels, model)
    left = some_off(pixels_without(pixels, "air_draft", evidence["air_draft"].size), model)
    assert numbers > 15.0 and left < 0.0

    def repeated(gained: float) -> float:
        own = replace(evidence["air_draft"], log_evidence=nothing + gained)
        found = evidence | {"air_draft": own}
        shares = dict.fromkeys(found, 0.25)
        return something_beside(EFFECTS, blocks, pixels, model, found, shares, []).repeated

    assert repeated(0.6 * numbers) == pytest.approx(0.4 * numbers - left)
    assert repeated(0.4 * numbers) == 0.0  # it gains too little
    wild, calm = tabulate_unknown(blocks, pixels, model), tabulate_nothing(blocks, pixels, model)
    less = without_repeated(wild, calm, 5.0).pixels - wild.pixels
    assert set(less.tolist()) == {0.0, -5.0} and less[-1] == -5.0


@pytest.mark.parametrize(("left", "named"), [(1.0, ("camera_translation",)), (7.0, ())])
def test_a_camera_leaves_no_warp_that_all_fabrics_share(
    left: float, named: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What it does to pictures is known exactly: a focal length that is off looks like a camera moved, but for that."""
    rng, size = np.random.default_rng(3), {"tx": 0.006, "ty": -0.004, "tz": 0.0}
    effect, blocks = get_effect("camera_translation"), []
    for block in fabrics(range(0), None):
        rows = 2.0 * rng.standard_normal((len(nodes(effect)), COUNT))
        measured = block.stated.measured + node_weights(effect, size) @ rows
        view = replace(block.stated, measured=measured, responses=block.stated.responses | {"camera_translation": rows})
        blocks.append(replace(block, stated=view, wide=view))
    still = {**quiet().responses, "camera_translation": np.zeros((len(nodes(effect)), 1))}
    pixels, names = PixelBlock(np.zeros(1), still, sensor_known=False), (*EFFECTS, "camera_translation")
    gained = name_cause(names, blocks, pixels, pairs=False).evidence
    nats = gained["camera_translation"].log_evidence - gained["none"].log_evidence

    moved = len(responses_at_place(blocks[0].stated.responses, "camera_translation", size))

    def gain(self: Mixture, given: object, granted: Sequence[np.ndarray]) -> np.ndarray:
        value = left if len(granted[0]) == moved else 1.9 * nats
        return np.array([value if name == "picture" else 0.0 for name in self.families])

    monkeypatch.setattr(Mixture, "gain", gain)
    assert name_cause(names, blocks, pixels).named == named
