"""Diagnose sealed sets without their labels, then open the labels and count."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from capture.capture_set import CAPTURES_FILE, CaptureSet
from diagnosis.baselines import BASELINES, baseline_answers
from diagnosis.blind_make import BLIND_FORMAT, LABELS_FOLDER, MANIFEST_FILE, case_name
from diagnosis.diagnose import GROUPS, DiagnosisOptions, diagnose
from diagnosis.drape_cache import DrapeCache
from diagnosis.effects import catalogue
from diagnosis.version import MODEL_VERSION
from renderer.atomic import write_atomically
from simcore.errors import InputError

REPORTS_FOLDER = "reports"
CONFIDENT = 0.8


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

    def probability(self, name: str) -> float:
        """Of one explanation with those declared inseparable from it."""
        probabilities = self.report["cause"]["probabilities"]
        return float(sum(probabilities.get(other, 0.0) for other in {name, *group_of(name)}))


def group_of(name: str) -> frozenset[str]:
    """The effects declared inseparable from one, itself included."""
    return next((group for group in GROUPS if name in group), frozenset({name}))


def same(answer: str, truth: str) -> bool:
    """Right, declared groups counting as one."""
    return answer in group_of(truth)


def answer_cases(
    out: Path,
    *,
    cache: DrapeCache,
    workers: int = 1,
    on_case: Callable[[float], None] | None = None,
) -> list[Answer]:
    """Diagnose all cases (those that have a report of this version keep it), then open their labels.

    Raises:
        InputError: no blind check there, a case or a label is missing, or a label was changed.
    """
    manifest = read_manifest(out)
    options = DiagnosisOptions(without=tuple(manifest["withhold"]), workers=workers)
    names = [case_name(number) for number in range(manifest["cases"])]
    (out / REPORTS_FOLDER).mkdir(exist_ok=True)
    for name in names:
        path = out / REPORTS_FOLDER / f"{name}.json"
        if not (path.exists() and json.loads(path.read_text(encoding="utf-8"))["model_version"] == MODEL_VERSION):
            found = diagnose(CaptureSet.load(out / name), options, cache=cache)
            document = found.report.as_json()
            document["baselines"] = baseline_answers(found)
            write_atomically(path, (json.dumps(document, indent=1) + "\n").encode())
        if on_case is not None:
            on_case(1.0)
    return [_open(out, name) for name in names]


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
    if manifest.get("format") != BLIND_FORMAT:
        raise InputError(f"{out}: format {manifest.get('format')!r} is not {BLIND_FORMAT}", code="blind_format")
    return dict(manifest)


def _open(out: Path, name: str) -> Answer:
    try:
        sealed = (out / LABELS_FOLDER / f"{name}.json").read_bytes()
        stated = json.loads((out / name / CAPTURES_FILE).read_text(encoding="utf-8"))["label_sha256"]
    except (OSError, ValueError, KeyError):
        raise InputError(f"{out}: the label of {name} or its hash is missing", code="blind_label_missing") from None
    if hashlib.sha256(sealed).hexdigest() != stated:
        raise InputError(f"{out}: the label of {name} is not the one that was sealed", code="blind_label_changed")
    report = json.loads((out / REPORTS_FOLDER / f"{name}.json").read_text(encoding="utf-8"))
    return Answer(name, json.loads(sealed), report, report.pop("baselines"))


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
    magnitude_inside: Share
    magnitude_error: float
    shrinkage: float
    calibration: tuple[tuple[float, float, int, float], ...]
    baselines: Mapping[str, Share]


def score(answers: Sequence[Answer]) -> Score:
    """Count."""
    by_kind = {kind: [a for a in answers if a.kind == kind] for kind in {a.kind for a in answers}}
    named, calm = by_kind.get("named", []), by_kind.get("none", [])
    wrong, two, withheld = (by_kind.get(k, []) for k in ("wrong_parameter", "two", "withheld"))
    right = [a for a in named if same(a.top, a.truth[0])]
    sizes = [_magnitude(a) for a in right if a.top == a.truth[0]]
    fractions = [a.report["shrinkage"]["fraction"] for a in right if a.report["shrinkage"]]
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
            sum(bool(a.named) and a.report["cause"]["probabilities"][a.top] > CONFIDENT for a in withheld),
            len(withheld),
        ),
        one_of_two=Share(sum(any(same(a.top, t) for t in a.truth) for a in two), len(two)),
        both_of_two=Share(sum(all(any(same(n, t) for n in a.named) for t in a.truth) for a in two), len(two)),
        magnitude_inside=Share(sum(inside for _, inside in sizes), len(sizes)),
        magnitude_error=float(np.median([error for error, _ in sizes])) if sizes else float("nan"),
        shrinkage=float(np.median(fractions)) if fractions else float("nan"),
        calibration=_calibration(single),
        baselines={
            name: Share(sum(same(a.baselines["names"][name], a.truth[0]) for a in named), len(named))
            for name in BASELINES
        },
    )


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


def _calibration(answers: Sequence[Answer]) -> tuple[tuple[float, float, int, float], ...]:
    """Stated probability of the answer against how often it was right, over none and single effects."""
    edges = (0.0, 0.4, 0.6, 0.8, 0.95, 1.0001)
    rows = []
    for low, high in pairwise(edges):
        own = [a for a in answers if low <= a.report["cause"]["probabilities"][a.top] < high]
        right = [same(a.top, a.truth[0]) if a.truth else a.top == "none" for a in own]
        rows.append((low, min(high, 1.0), len(own), float(np.mean(right)) if own else float("nan")))
    return tuple(rows)
