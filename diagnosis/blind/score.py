"""Diagnose sealed sets without their labels, then open the labels and count."""

from __future__ import annotations

import hashlib
import io
import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.capture_set import CAPTURES_FILE, CaptureSet
from diagnosis.blind.baselines import BASELINES, baseline_answers
from diagnosis.blind.claims import Claims, alone
from diagnosis.blind.classifier import Classifier, example_parts, features
from diagnosis.blind.make import BLIND_FORMAT, LABELS_FOLDER, MANIFEST_FILE, MANIFEST_KEYS, case_name, is_sealed
from diagnosis.blind.places import is_its_place
from diagnosis.blind.verify import verify
from diagnosis.diagnose import Diagnosis, DiagnosisOptions, diagnose
from diagnosis.effects import catalogue, get_effect
from diagnosis.groups import group_of
from diagnosis.simulation.drape_cache import DrapeCache
from diagnosis.version import MODEL_VERSION
from renderer.atomic import write_atomically
from simcore.errors import DrapemeterError, InputError, SimulationError

REPORTS_FOLDER = "reports"
EXAMPLES_FOLDER = "examples"
CONFIDENT = 0.8
LEAST_FRACTION = 0.1
"""A true effect that closes less of the gap says nothing about how much a found one should."""
CAPTURES_CANNOT_BE_USED = ("cloth_not_found", "cloth_not_seen", "nothing_in_view", "pins_not_found")
"""Codes of errors that one case's pictures are to blame for."""


@dataclass(frozen=True)
class Answer:
    """A case's diagnosis and its label.

    Attributes:
        name: of the case.
        label: as sealed.
        report: the diagnosis, as in ``report.json``.
        baselines: what simpler methods said.
    """

    name: str
    label: Mapping[str, Any]
    report: Mapping[str, Any]
    baselines: Mapping[str, Any]

    @property
    def kind(self) -> str:
        """Of the case."""
        return str(self.label["kind"])

    @property
    def truth(self) -> tuple[str, ...]:
        """Effects that are in it."""
        return tuple(e["name"] for e in self.label["effects"])

    @property
    def top(self) -> str:
        """What was answered."""
        return str(self.report["cause"]["top"])

    @property
    def named(self) -> tuple[str, ...]:
        """All effects that were named."""
        return tuple(e["name"] for e in self.report["cause"]["effects"])

    @property
    def certainty(self) -> float:
        """Of what was answered: all that was named, with what is declared inseparable from it."""
        answered = self.named or (self.top,)
        probabilities = self.report["cause"]["probabilities"]
        return float(
            sum(probabilities.get(n, 0.0) for n in {one for name in answered for one in (name, *group_of(name))})
        )

    def probability(self, name: str) -> float:
        """Of one explanation with those declared inseparable from it."""
        probabilities = self.report["cause"]["probabilities"]
        return float(sum(probabilities.get(other, 0.0) for other in {name, *group_of(name)}))


def same(answer: str, truth: str) -> bool:
    """Right, declared groups counting as one."""
    return answer in group_of(truth)


def answer_cases(
    out: Path,
    *,
    cache: DrapeCache,
    workers: int = 1,
    seconds: float = math.inf,
    make: Callable[[int], None] | None = None,
    on_case: Callable[[float], None] | None = None,
) -> list[Answer]:
    """Diagnose all cases (those that have a report of this version keep it), then open their labels.

    Several processes may do so at once: each takes groups of cases that no other has.

    Args:
        out: what ``blind make`` wrote.
        cache: of simulations.
        workers: processes.
        seconds: after which no further case is begun; what is done counts.
        make: makes a case, by its number, that is not there yet; by default such cases are left out.
        on_case: called with 1 for every case.

    Raises:
        InputError: no blind check there, no case is done, a case or a label is missing, or a label was changed.
    """
    began = time.monotonic()
    manifest = read_manifest(out)
    options = DiagnosisOptions(without=tuple(manifest["withhold"]), workers=workers)
    options.chosen()
    (out / REPORTS_FOLDER).mkdir(exist_ok=True)
    numbers = range(manifest["cases"])
    with Claims(out) as claims:
        for number in numbers:
            name = case_name(number)
            path = out / REPORTS_FOLDER / f"{name}.json"
            if not _is_answered(path):
                if time.monotonic() - began > seconds or not claims.take(number):
                    continue
                if _is_answered(path):  # by another process, since we looked
                    continue
                failed = path.with_suffix(".failed")
                failed.unlink(missing_ok=True)
                try:
                    if make is not None:
                        make(number)
                    if not is_sealed(out / name):
                        continue
                    _answer(out, name, options, cache)
                except DrapemeterError as error:  # seeds are fixed: it would stand in the way of all others for good
                    if not _is_of_this_case(error):
                        raise
                    write_atomically(failed, f"{error} [{error.code}]\n".encode())
                    continue
            if on_case is not None:
                on_case(1.0)
    done = [name for name in map(case_name, numbers) if _is_answered(out / REPORTS_FOLDER / f"{name}.json")]
    if not done and make is None and not any(is_sealed(out / case_name(number)) for number in numbers):
        raise InputError(f"{out}: its cases are planned and not made: give --make", code="blind_nothing_done")
    if not done:
        raise InputError(f"{out}: no case is diagnosed yet: give more time", code="blind_nothing_done")
    return open_labels(out, done, cache)


def open_labels(out: Path, names: Sequence[str], cache: DrapeCache) -> list[Answer]:
    """:func:`open_label` of diagnosed cases; processes at the same ones share them, then wait for one another's.

    Raises:
        InputError: as there.
    """
    answers: dict[str, Answer] = {}
    for wait in (False, True):
        for name in names:
            if name in answers:
                continue
            with alone(out, name, wait=wait) as mine:
                if mine:
                    answers[name] = open_label(out, name, cache)
    return [answers[name] for name in names]


def _answer(out: Path, name: str, options: DiagnosisOptions, cache: DrapeCache) -> None:
    start = time.process_time()
    found = diagnose(CaptureSet.load(out / name), options, cache=cache)
    document = found.report.as_json()
    document["baselines"] = baseline_answers(found)
    document["pin_radius_m"] = found.pin_radius_m
    document["cpu_seconds"] = round(time.process_time() - start, 1)
    _keep_examples(out / EXAMPLES_FOLDER / f"{name}.npz", found)
    write_atomically(out / REPORTS_FOLDER / f"{name}.json", (json.dumps(document, indent=1) + "\n").encode())


def _is_of_this_case(error: DrapemeterError) -> bool:
    """What its simulations or pictures are to blame for, not the plan, the catalogue or the disk."""
    return isinstance(error, SimulationError) or error.code in CAPTURES_CANNOT_BE_USED


def _keep_examples(path: Path, found: Diagnosis) -> None:
    """What a classifier sees of a set, and what one can be trained on."""
    blocks = [b for b in found.blocks if b.scene == "stretch"] or list(found.blocks)
    parts = {"features": features(blocks, found.pixels), **example_parts(blocks, found.pixels)}
    path.parent.mkdir(exist_ok=True)
    content = io.BytesIO()
    compact: dict[str, Any] = {key: value.astype(np.float32) for key, value in parts.items()}
    np.savez_compressed(content, **compact)
    write_atomically(path, content.getvalue())


def classify(out: Path, other: Path, answers: Sequence[Answer], effects: Sequence[str]) -> list[Answer]:
    """Add what a plain classifier says that was trained on another check's fabrics and seeds.

    Raises:
        InputError: the other check has not been scored.
    """
    paths = sorted((other / EXAMPLES_FOLDER).glob("*.npz"))
    if not paths:
        raise InputError(f"{other}: nothing to train on: run `drapemeter blind score` there first", code="blind_train")
    trained = Classifier.train([_arrays(path) for path in paths], effects)
    found = []
    for answer in answers:
        name = trained.effect(_arrays(out / EXAMPLES_FOLDER / f"{answer.name}.npz")["features"])
        names = {**answer.baselines["names"], "classifier": name}
        found.append(replace(answer, baselines={**answer.baselines, "names": names}))
    return found


def _arrays(path: Path) -> dict[str, NDArray[np.float64]]:
    with np.load(path) as data:
        return {key: np.asarray(data[key], dtype=np.float64) for key in data.files}


def _is_answered(path: Path) -> bool:
    return path.exists() and json.loads(path.read_text(encoding="utf-8"))["model_version"] == MODEL_VERSION


def read_manifest(out: Path) -> dict[str, Any]:
    """What ``blind make`` wrote of the whole check.

    Raises:
        InputError: it is not there or of another format.
    """
    try:
        manifest = json.loads((out / MANIFEST_FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        raise InputError(
            f"{out} holds no blind check: make one with `drapemeter blind make N {out}`", code="blind_missing"
        ) from None
    stated = manifest.get("format") if isinstance(manifest, dict) else None
    if stated != BLIND_FORMAT:
        raise InputError(f"{out}: format {stated!r} is not {BLIND_FORMAT}", code="blind_format")
    missing = [key for key in MANIFEST_KEYS if key not in manifest]
    if missing:
        raise InputError(f"{out / MANIFEST_FILE} lacks {', '.join(missing)}: make another check", code="blind_format")
    return dict(manifest)


def open_label(out: Path, name: str, cache: DrapeCache) -> Answer:
    """Open a diagnosed case's label and, where it holds further captures, check the shrinkage on them (once).

    Raises:
        InputError: the label or its hash is missing, or is not what was sealed.
    """
    try:
        sealed = (out / LABELS_FOLDER / f"{name}.json").read_bytes()
        stated = json.loads((out / name / CAPTURES_FILE).read_text(encoding="utf-8"))["label_sha256"]
    except (OSError, ValueError, KeyError, TypeError):
        raise InputError(f"{out}: the label of {name} or its hash is missing", code="blind_label_missing") from None
    if hashlib.sha256(sealed).hexdigest() != stated:
        raise InputError(f"{out}: the label of {name} is not the one that was sealed", code="blind_label_changed")
    path = out / REPORTS_FOLDER / f"{name}.json"
    report = json.loads(path.read_text(encoding="utf-8"))
    label = json.loads(sealed)
    if "verified" not in report:
        report["verified"] = verify(out / LABELS_FOLDER / name, label, report, cache)
        write_atomically(path, (json.dumps(report, indent=1) + "\n").encode())
    return Answer(name, label, report, report.pop("baselines"))


@dataclass(frozen=True)
class Share:
    """A count out of a total."""

    hits: int
    of: int

    @property
    def value(self) -> float:
        """NaN of none."""
        return self.hits / self.of if self.of else float("nan")

    def __str__(self) -> str:
        return f"{self.value:.2f} ({self.hits} of {self.of})" if self.of else "none drawn"


@dataclass(frozen=True)
class Score:
    """What a blind check showed; see ``docs/blind-check.md`` for the words.

    ``calibration`` lists (stated probability's lower and upper bound, cases, share that was right).
    """

    top1: Share
    stage: Share
    probability_of_truth: float
    false_alarms: Share
    none_named: Share
    wrong_parameter_blamed: Share
    withheld_unknown: Share
    withheld_misnamed: Share
    one_of_two: Share
    both_of_two: Share
    place_right: Share
    magnitude_inside: Share
    magnitude_error: float
    shrinkage: float
    shrinkage_relative: float
    shrinkage_covered: Share
    control: float
    parameter_error: tuple[float, float, float]
    top1_strict: Share
    calibration: tuple[tuple[float, float, int, float], ...]
    baselines: Mapping[str, Share]


def score(answers: Sequence[Answer]) -> Score:
    """Count."""
    by_kind = {kind: [a for a in answers if a.kind == kind] for kind in {a.kind for a in answers}}
    named, calm = by_kind.get("named", []), by_kind.get("none", [])
    wrong, two, withheld = (by_kind.get(k, []) for k in ("wrong_parameter", "two", "withheld"))
    right = [a for a in named if same(a.top, a.truth[0])]
    sizes = [_magnitude(a) for a in right if a.top == a.truth[0]]
    placed = [found for found in (_is_placed(a) for a in right if a.top == a.truth[0]) if found is not None]
    fractions = [a.report["shrinkage"]["fraction"] for a in right if a.report["shrinkage"]]
    controls = [a.report["shrinkage"]["control"]["fraction"] for a in right if a.report["shrinkage"]]
    checked = [a.report["verified"] for a in named if a.report.get("verified")]
    relative = [v["fraction"] / v["true_fraction"] for v in checked if v["true_fraction"] > LEAST_FRACTION]
    covered = [v["covered"] for v in checked if v["covered"] is not None]
    errors = [a.report["verified"]["parameter_error"] for a in right if a.report.get("verified")]
    known = np.array([e for e in errors if e is not None])
    single = [a for a in answers if a.kind in ("named", "none", "wrong_parameter")]
    return Score(
        top1=Share(len(right), len(named)),
        stage=Share(sum(_stage(a.top) == a.label["effects"][0]["stage"] for a in named), len(named)),
        probability_of_truth=float(np.mean([a.probability(a.truth[0]) for a in named])) if named else float("nan"),
        false_alarms=Share(sum(a.report["gap"]["detected"] for a in calm), len(calm)),
        none_named=Share(sum(bool(a.named) for a in calm), len(calm)),
        wrong_parameter_blamed=Share(sum(bool(a.named) for a in wrong), len(wrong)),
        withheld_unknown=Share(sum(a.top == "unknown" for a in withheld), len(withheld)),
        withheld_misnamed=Share(
            sum(bool(a.named) and a.certainty > CONFIDENT for a in withheld),
            len(withheld),
        ),
        one_of_two=Share(sum(any(same(a.top, t) for t in a.truth) for a in two), len(two)),
        both_of_two=Share(sum(all(any(same(n, t) for n in a.named) for t in a.truth) for a in two), len(two)),
        place_right=Share(sum(placed), len(placed)),
        magnitude_inside=Share(sum(inside for _, inside in sizes), len(sizes)),
        magnitude_error=float(np.median([error for error, _ in sizes])) if sizes else float("nan"),
        shrinkage=_median(fractions),
        shrinkage_relative=_median(relative),
        shrinkage_covered=Share(sum(covered), len(covered)),
        control=_median(controls),
        parameter_error=(_median(known[:, 0]), _median(known[:, 1]), _median(known[:, 2]))
        if len(known)
        else (math.nan, math.nan, math.nan),
        top1_strict=Share(sum(a.top == a.truth[0] for a in named), len(named)),
        calibration=_calibration(single),
        baselines={
            name: Share(sum(same(a.baselines["names"][name], a.truth[0]) for a in named), len(named))
            for name in (*BASELINES, "classifier")
            if all(name in a.baselines["names"] for a in named)
        },
    )


def _median(values: Sequence[float] | NDArray[np.float64]) -> float:
    return float(np.median(values)) if len(values) else float("nan")


def _stage(name: str) -> str:
    return catalogue()[name].stage.value if name in catalogue() else name


def _magnitude(answer: Answer) -> tuple[float, bool]:
    """Relative error of the named effect's size, and whether all of it lies in the stated interval."""
    truth = answer.label["effects"][0]["magnitude"]
    found = next(e for e in answer.report["cause"]["effects"] if e["name"] == answer.truth[0])
    if isinstance(truth, dict):
        a = np.array([truth[k] for k in truth])
        b = np.array([found["magnitude"][k] for k in truth])
        inside = all(found["interval_90"][k][0] <= truth[k] <= found["interval_90"][k][1] for k in truth)
        return float(np.linalg.norm(a - b) / np.linalg.norm(a)), inside
    low, high = found["interval_90"]
    return abs(found["magnitude"] - truth) / abs(truth), low <= truth <= high


def _is_placed(answer: Answer) -> bool | None:
    """Whether the named effect was found beside where it is; None where that says nothing of it."""
    name = answer.truth[0]
    found = next(e for e in answer.report["cause"]["effects"] if e["name"] == name).get("place")
    if not found or not get_effect(name).between:
        return None
    return is_its_place(name, answer.label["effects"][0]["place"], found)


def _calibration(answers: Sequence[Answer]) -> tuple[tuple[float, float, int, float], ...]:
    """Stated probability of the answer against how often it was right, over none and single effects."""
    edges = (0.0, 0.4, 0.6, 0.8, 0.95, 1.0001)
    rows = []
    for low, high in pairwise(edges):
        own = [a for a in answers if low <= a.certainty < high]
        right = [same(a.top, a.truth[0]) if a.truth else a.top == "none" for a in own]
        rows.append((low, min(high, 1.0), len(own), float(np.mean(right)) if own else float("nan")))
    return tuple(rows)
