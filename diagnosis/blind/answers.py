"""Diagnose sealed sets without their labels, then open the labels."""

from __future__ import annotations

import hashlib
import io
import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.capture_set import CAPTURES_FILE, CaptureSet
from diagnosis.blind.baselines import baseline_answers
from diagnosis.blind.claims import Claims, alone
from diagnosis.blind.classifier import Classifier, example_parts, features, known_as_tried
from diagnosis.blind.make import (
    BLIND_FORMAT,
    CATALOGUE,
    LABELS_FOLDER,
    MANIFEST_FILE,
    MANIFEST_KEYS,
    case_name,
    is_sealed,
)
from diagnosis.blind.same_catalogue import catalogue_key
from diagnosis.blind.verify import verify
from diagnosis.diagnose import Diagnosis, DiagnosisOptions, diagnose
from diagnosis.groups import group_of
from diagnosis.simulation.drape_cache import DrapeCache
from diagnosis.version import MODEL_VERSION
from renderer.atomic import write_atomically
from simcore.errors import DrapemeterError, InputError, SimulationError

REPORTS_FOLDER = "reports"
EXAMPLES_FOLDER = "examples"
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
        """Of what was answered, with what is declared inseparable from it; of two effects that both are there."""
        answered = self.named or (self.top,)
        if len(answered) == 2 and self.report["cause"].get("both_probability") is not None:
            return float(self.report["cause"]["both_probability"])
        probabilities = self.report["cause"]["probabilities"]
        return float(
            sum(probabilities.get(n, 0.0) for n in {one for name in answered for one in (name, *group_of(name))})
        )

    def probability(self, name: str) -> float:
        """Of one explanation with those declared inseparable from it."""
        probabilities = self.report["cause"]["probabilities"]
        return float(sum(probabilities.get(other, 0.0) for other in {name, *group_of(name)}))


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
    tried = catalogue_key()
    (out / REPORTS_FOLDER).mkdir(exist_ok=True)
    numbers = range(manifest["cases"])
    with Claims(out) as claims:
        for number in numbers:
            name = case_name(number)
            path = out / REPORTS_FOLDER / f"{name}.json"
            if not _is_answered(path, tried):
                if time.monotonic() - began > seconds or not claims.take(number):
                    continue
                if _is_answered(path, tried):  # by another process, since we looked
                    continue
                failed = path.with_suffix(".failed")
                try:
                    if make is not None:
                        make(number)
                    if not is_sealed(out / name):
                        continue
                    failed.unlink(missing_ok=True)
                    _answer(out, name, options, cache, tried)
                except DrapemeterError as error:  # seeds are fixed: it would stand in the way of all others for good
                    if not _is_of_this_case(error):
                        raise
                    write_atomically(failed, f"{error} [{error.code}]\n".encode())
                    continue
            if on_case is not None:
                on_case(1.0)
    done = [name for name in map(case_name, numbers) if _is_answered(out / REPORTS_FOLDER / f"{name}.json", tried)]
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


def _answer(out: Path, name: str, options: DiagnosisOptions, cache: DrapeCache, tried: str) -> None:
    start = time.process_time()
    found = diagnose(CaptureSet.load(out / name), options, cache=cache)
    document = found.report.as_json()
    document[CATALOGUE] = tried
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


def examples_of(other: Path, effects: Sequence[str]) -> list[dict[str, NDArray[np.float64]]]:
    """What another check has to train a classifier on.

    Raises:
        InputError: it has not been scored, or by another version, whose effects were tried at other sizes or places.
    """
    examples = [_arrays(path) for path in sorted((other / EXAMPLES_FOLDER).glob("*.npz"))]
    if not examples:
        raise InputError(f"{other}: nothing to train on: run `drapemeter blind score` there first", code="blind_train")
    known = [known_as_tried(one, effects) for one in examples]
    there = [{name for name in effects if name in one} for one in examples]
    if not known[0] or any(own != known[0] for own in (*known, *there)):
        raise InputError(
            f"{other}: its examples are of another version's effects, tried at other sizes or places: score a check "
            "with this version",
            code="blind_train",
        )
    return examples


def classify(out: Path, other: Path, answers: Sequence[Answer], effects: Sequence[str]) -> list[Answer]:
    """Add what a plain classifier says that was trained on another check's fabrics and seeds.

    Raises:
        InputError: see :func:`examples_of`.
    """
    trained = Classifier.train(examples_of(other, effects), effects)
    found = []
    for answer in answers:
        name = trained.effect(_arrays(out / EXAMPLES_FOLDER / f"{answer.name}.npz")["features"])
        names = {**answer.baselines["names"], "classifier": name}
        found.append(replace(answer, baselines={**answer.baselines, "names": names}))
    return found


def _arrays(path: Path) -> dict[str, NDArray[np.float64]]:
    with np.load(path) as data:
        return {key: np.asarray(data[key], dtype=np.float64) for key in data.files}


def _is_answered(path: Path, catalogue: str) -> bool:
    """By this version, with this catalogue of effects (:func:`catalogue_key`)."""
    if not path.exists():
        return False
    report = json.loads(path.read_text(encoding="utf-8"))
    return bool(report["model_version"] == MODEL_VERSION and report.get(CATALOGUE) == catalogue)


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
