"""An effect on the cloth is simulated at the size that it has beside one on camera or sensor."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from diagnosis.afresh import through as through_pictures
from diagnosis.afresh.through import THROUGH_PAIRS, THROUGH_ROUNDS, look_through, with_pictures
from tests.diagnosis.trial_parts import TrialWorkers

CAMERA, BLUR = {"tx": 0.003, "ty": 0.0, "tz": 0.0}, {"magnitude": 1.0}
SIZES = {"camera_translation": CAMERA, "sensor_smoothing": BLUR}


def pair_of(first: str, second: str, nats: float, size: float = 0.004) -> Any:
    """Two effects; those on the cloth have one size."""
    sizes = {name: SIZES.get(name, {"magnitude": size}) for name in (first, second)}
    return SimpleNamespace(first=first, second=second, sizes=sizes, evidence=SimpleNamespace(log_evidence=nats))


def cause_of(*pairs: Any, named: tuple[str, ...] = ()) -> Any:
    evidence = {"none": 0.0, "unknown": 30.0, "camera_translation": 20.0, "pin_drop": 3.0}
    entries = {name: SimpleNamespace(log_evidence=nats) for name, nats in evidence.items()}
    return SimpleNamespace(evidence=entries, tried=list(pairs), named=named, size=lambda name: SIZES[name])


def test_one_of_two_is_on_the_cloth_and_both_are_not_far_behind_the_best() -> None:
    likely = [
        pair_of("camera_translation", "pin_drop", 21.0),
        pair_of("hem_weight", "sensor_smoothing", 18.0),
        pair_of("camera_translation", "panel_tilt", 17.0),  # one too many
    ]
    others = [
        pair_of("pin_drop", "hem_weight", 22.0),  # both on the cloth
        pair_of("camera_translation", "sensor_smoothing", 22.0),  # none
        pair_of("camera_translation", "bending_hysteresis", 22.0),  # another one in each repeat
        pair_of("camera_translation", "air_draft", 15.9),  # far behind
    ]
    assert with_pictures(cause_of(*likely, *others)) == likely[:THROUGH_PAIRS]
    assert with_pictures(cause_of(*others)) == []


def a_trial(*rounds: Any, then: tuple[str, ...]) -> tuple[list[Any], list[str] | None]:
    """What was simulated through which camera, where these pairs are likely one after the other; through which effects
    on the camera that is then seen, None where it is not kept.
    """
    first: Any = SimpleNamespace(result=0, sizes={"pin_drop": [{"magnitude": 0.01}]})
    first.copy = lambda: SimpleNamespace(result=1)
    workers = TrialWorkers(lambda: SimpleNamespace(result=1 + len(workers.wanted)), untaught=first)

    def name(results: list[int]) -> Any:
        number = max(results[0] - 1, 0)
        return cause_of(*rounds[number : number + 1], named=then)

    def weigh(results: list[int], found: Any) -> Any:
        raise AssertionError("pairs say what is simulated")

    last: list[str] | None = None

    def seen_through(look: Any, camera: Any) -> Any:
        nonlocal last
        last = [name for name, _ in camera]
        return look

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(through_pictures, "seen_through", seen_through)
        kept = look_through({"f1": first}, weigh, name, "stretch", workers)  # type: ignore[arg-type]
    assert (kept["f1"] is first) is (last is None)
    simulated = []
    for (own,), through in zip(workers.wanted, workers.through, strict=True):
        simulated.append((own[0], own[1]["magnitude"], [name for name, _ in through]))
    return simulated, last


@pytest.mark.parametrize(
    ("other", "camera"), [("camera_translation", ["camera_translation"]), ("sensor_smoothing", [])]
)
def test_it_is_seen_through_a_camera(other: str, camera: list[str]) -> None:
    assert a_trial(pair_of(other, "pin_drop", 21.0), then=("pin_drop",)) == ([("pin_drop", 0.004, camera)], [])


def test_again_where_its_size_has_moved() -> None:
    rounds = [pair_of("camera_translation", "pin_drop", 21.0, size) for size in (0.004, 0.006, 0.008)]
    simulated, kept = a_trial(*rounds, then=("pin_drop", "camera_translation"))
    assert [size for _, size, _ in simulated] == [0.004, 0.006] and len(simulated) == THROUGH_ROUNDS
    assert kept == ["camera_translation"]


def test_what_is_then_not_named_is_forgotten() -> None:
    assert a_trial(pair_of("camera_translation", "pin_drop", 21.0), then=("camera_translation",))[1] is None


def test_a_size_that_was_simulated_is_not_again() -> None:
    assert a_trial(pair_of("camera_translation", "pin_drop", 21.0, 0.0101), then=("pin_drop",)) == ([], None)
