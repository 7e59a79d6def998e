"""What a report says in one sentence follows from its numbers."""

from __future__ import annotations

from types import SimpleNamespace

from diagnosis.pages.sentence import sentence
from diagnosis.report import Gap, Shrinkage
from tests.diagnosis.plain_report import report


def told(top: str, p: float, *beside: str, detected: bool = True, value: float = 1.0, **also: float) -> str:
    """The sentence of a report; ``also``: probabilities of other explanations."""
    made = report(top, p)
    effects = tuple(made.cause.effects[0].model_copy(update={"name": name}) for name in (top, *beside) if beside)
    probabilities = made.cause.probabilities | also
    cause = made.cause.model_copy(update={"effects": effects or made.cause.effects, "probabilities": probabilities})
    gap = made.gap.model_copy(update={"detected": detected, "value": value})
    shown = made.model_copy(update={"cause": cause, "gap": gap})
    return sentence(SimpleNamespace(report=shown, cause=SimpleNamespace(both_probability=0.97)))  # type: ignore[arg-type]


def test_the_sentence_says_what_the_numbers_say() -> None:
    assert told("hem_weight", 0.9).startswith("They differ (1.00 mm")
    assert told("hem_weight", 0.9, detected=False).startswith("That they differ at all is not certain")
    assert "do not tell what is missing" in told("hem_weight", 0.45)
    both = told("hem_weight", 0.49, "pin_spacing")
    assert "hem_weight with pin_spacing (probability 0.97)" in both and "They differ" in both
    assert "agree" in told("none", 0.9, detected=False)
    assert "They differ" in told("none", 0.9) and "agree" not in told("none", 0.9)


def test_two_effects_that_are_not_sure_are_not_said_to_be_likelier_than_one() -> None:
    made = report("hem_weight", 0.7)
    crease = made.cause.effects[0].model_copy(update={"name": "crease"})
    shown = made.model_copy(update={"cause": made.cause.model_copy(update={"effects": (*made.cause.effects, crease)})})
    text = sentence(SimpleNamespace(report=shown, cause=SimpleNamespace(both_probability=0.21)))  # type: ignore[arg-type]
    assert "hem_weight is likeliest, alone or beside another effect; that it is there with crease" in text
    assert "probability 0.21 only" in text


def test_where_the_shape_is_within_its_floor_the_sentence_says_what_differs() -> None:
    made = report("unknown", 0.97)
    for key, words in (("p_pixels", "panel and pixels, p = 1e-09"), ("p_factor", "have in common, p = 1e-09")):
        ps = {"p_shape": 1.0, "p_pixels": 1.0, "p_factor": 1.0, key: 1e-9}
        gap = Gap.model_validate({**made.gap.model_dump(), "value": 0.3, **ps})
        text = sentence(SimpleNamespace(report=made.model_copy(update={"gap": gap})))  # type: ignore[arg-type]
        assert words in text and "the cloth's shape by 0.30 mm within the noise floor" in text


def test_where_pixels_alone_raise_the_alarm_the_shape_is_not_blamed_for_it() -> None:
    """The shape lies beyond the scatter of repeats nearly always: by no more than is expected."""
    made = report("unknown", 0.97)
    ps = {"p_shape": 0.9, "p_pixels": 1e-9, "p_factor": 1.0}
    pixels = "panel and pixels, p = 1e-09; the cloth's shape by 1.00 mm against"
    for shape, words in ((0.9, pixels), (1e-6, "(1.00 mm")):
        gap = Gap.model_validate({**made.gap.model_dump(), "value": 1.0, **ps, "p_shape": shape})
        text = sentence(SimpleNamespace(report=made.model_copy(update={"gap": gap})))  # type: ignore[arg-type]
        assert words in text


def test_a_declared_twin_that_is_as_likely_is_told_of_and_counts_with_what_is_named() -> None:
    level = told("air_draft", 0.49, panel_tilt=0.49, pin_spacing=0.02)
    assert "air_draft, or in its place panel_tilt" in level and "together probability 0.98" in level
    assert "panel_tilt" not in told("air_draft", 0.9, panel_tilt=0.02, pin_spacing=0.08)
    unsure = told("air_draft", 0.25, panel_tilt=0.2, pin_spacing=0.55)
    assert "air_draft or panel_tilt is likeliest, with probability 0.45 only" in unsure


def test_where_nothing_is_found_in_a_wide_gap_the_sentence_says_why_that_is_no_contradiction() -> None:
    assert "stated of the fabrics" in told("none", 0.9, detected=False, value=3.0)
    assert "stated of the fabrics" not in told("none", 0.9, detected=False, value=0.6)


def test_an_answer_from_a_part_of_the_catalogue_does_not_speak_for_all_of_it() -> None:
    made = report("unknown")
    assert "no effect of the catalogue explains it" in sentence(SimpleNamespace(report=made))  # type: ignore[arg-type]
    few = {name: p for name, p in made.cause.probabilities.items() if name != "crease"}
    made = made.model_copy(update={"cause": made.cause.model_copy(update={"probabilities": few})})
    assert "no effect that was tried explains it" in sentence(SimpleNamespace(report=made))  # type: ignore[arg-type]


def closed(top: str, unit: str = "mm", fraction: float = 0.9, named_without: tuple[tuple[str, ...], ...] = ()) -> str:
    """The sentence of a report with a shrinkage, of a gap that is smaller than its floor."""
    made = report(top, 0.95)
    shrinkage = Shrinkage(
        held_out=("a",), before=6.0, after=1.5, noise_floor=1.0, repeats=1.0, fraction=fraction, unit=unit,
        interval_90=(-1.0, 1.0), named_without=named_without,
    )  # fmt: skip
    gap = made.gap.model_copy(update={"value": 0.3})
    return sentence(SimpleNamespace(report=made.model_copy(update={"shrinkage": shrinkage, "gap": gap})))  # type: ignore[arg-type]


def test_the_sentence_says_what_it_is_that_goes_away() -> None:
    assert "They differ (0.30 mm within the noise floor of 0.50 mm)" in closed("hem_weight")
    assert "90 % of the gap above the floor goes away" in closed("hem_weight")
    pixels = closed("depth_bias", "standard deviations")
    assert "They differ (panel and pixels by 6.0 standard deviations on held-out captures" in pixels
    assert "the cloth's shape by 0.30 mm" in pixels
    assert "90 % of what panel and pixels show above the floor goes away" in pixels
    assert "Yet with it, the gap does not shrink" in closed("pin_drop", fraction=-0.03)
    assert "no simulation comes nearer with it" in closed("bending_hysteresis")
    assert "no simulation" not in closed("hem_weight")


def test_the_sentence_says_how_often_what_is_named_was_named_without_what_is_held_out() -> None:
    draft, tilt, nothing, curl = ("air_draft",), ("panel_tilt",), (), ("edge_curl",)
    assert "held-out captures." in closed("air_draft", named_without=(draft, tilt, ("air_draft", "crease")))
    some = closed("air_draft", fraction=0.11, named_without=(draft, nothing, curl))
    assert "11 % of the gap" in some and "the others name it in 1 of 3 turns" in some
    none = closed("air_draft", fraction=0.0, named_without=(nothing, curl))
    assert "it would not be named" in none and "was not measured" in none and "does not shrink" not in none
