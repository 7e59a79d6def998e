"""The page of a blind check, Markdown."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from diagnosis.blind.answers import Answer
from diagnosis.blind.make import BLIND_JITTER, hidden_effects
from diagnosis.blind.score import Score
from diagnosis.blind.verify import RESOLUTION_M
from diagnosis.groups import GROUPS
from diagnosis.synthesis import SynthesisPlan
from diagnosis.version import MODEL_VERSION

AIMS = (
    ("top1", "effect named right (declared groups count as one)", "at least 0.90"),
    ("stage", "stage right", ""),
    ("false_alarms", "gap alarmed although nothing is there", "at most 0.05"),
    ("none_named", "effect named although nothing is there", "at most 0.05"),
    ("wrong_parameter_blamed", "effect named although one parameter of one fabric is wrong", "at most 0.10"),
    ("withheld_unknown", "withheld effect answered `unknown`", "at least 0.70"),
    ("withheld_misnamed", "withheld effect misnamed with p > 0.8", "at most 0.10"),
    ("one_of_two", "one of two effects named first", ""),
    ("both_of_two", "both of two effects named", "at least 0.70"),
    ("place_right", "crease or curl found at the tried place nearest to its own, or less than a step away", ""),
    ("magnitude_inside", "magnitude inside its 90 % interval", "0.85 to 0.95"),
    ("top1_strict", "effect named right, groups not counted as one", ""),
    ("shrinkage_covered", "share closed on further, sealed captures inside the stated 90 % interval", "0.85 to 0.95"),
    ("covered_below_one", "the same of shares below 1, above which none lies", ""),
)

TRAINED = (
    "Classifier: a random forest on residuals, trained on cases assembled from the responses of another check's "
    "fabrics and seeds. "
)


def render_page(manifest: Mapping[str, Any], answers: Sequence[Answer], score: Score) -> str:
    """All tables of the check; every case is listed."""
    kinds = Counter(a.kind for a in answers)
    scenes = " and ".join(manifest["scenes"])
    groups = "; ".join(", ".join(sorted(group)) for group in GROUPS)
    lines = [
        "# Blind check of the diagnosis",
        "",
        f"Written by `drapemeter blind score` ({MODEL_VERSION}), not by hand. {len(answers)} of {manifest['cases']} "
        f"sealed cases, as many as were diagnosed when it was written, from seed {manifest['seed']}: "
        f"{manifest['fabrics']} fabrics x {scenes} x {manifest['repeats']} repeats each, of {manifest['pool']} "
        f"fabrics, simulated on cells of {1e3 * manifest['resolution_m']:.3g} mm (the diagnosis uses "
        f"{1e3 * RESOLUTION_M:.3g} mm), stated parameters {100 * SynthesisPlan.parameters_cv:.3g} % off, magnets "
        f"{1e3 * BLIND_JITTER.pin_m:.3g} mm off in every repeat, sensor noise. Labels lay in files of "
        "their own, their SHA-256 in the sets, and were opened after these cases had been diagnosed.",
        "",
        f"Cases by kind: {', '.join(f'{k} {n}' for k, n in sorted(kinds.items()))}. Withheld from the catalogue: "
        f"{', '.join(manifest['withhold']) or 'nothing'}. Declared inseparable, counted as one: {groups}. Never drawn, "
        f"as these scenes do not show it: {', '.join(hidden_effects(manifest))}.",
        "",
        "| what | measured | aim |",
        "|---|---|---|",
        *(f"| {text} | {getattr(score, name)} | {aim} |" for name, text, aim in AIMS),
        f"| mean probability of the truth | {score.probability_of_truth:.2f} | at least 0.8 |",
        f"| median relative error of the magnitude | {score.magnitude_error:.2f} | |",
        f"| median share of the gap above the floor that goes away on held-out captures | {score.shrinkage:.2f} | |",
        f"| the same of the most flexible wrong effect (control) | {score.control:.2f} | |",
        "| median share closed on further captures, relative to the true effect's at its true size (all named cases) | "
        f"{score.shrinkage_relative:.2f} | at least 0.8 |",
        "| median error of the parameters as stated, refitted without, refitted with the effect (named right) | "
        f"{', '.join(f'{error:.3f}' for error in score.parameter_error)} | |",
        "",
        "## Beside simpler methods (named cases)",
        "",
        "| method | right |",
        "|---|---|",
        f"| this diagnosis | {score.top1} |",
        *(f"| {name.replace('_', ' ')} | {share} |" for name, share in score.baselines.items()),
        "",
        f"{TRAINED if 'classifier' in score.baselines else ''}"
        "Nearest template: largest cosine between residual and an effect's response. Least residual: the effect that "
        "leaves least, at the best of its simulated sizes. Both see shapes in "
        f"`{'stretch' if 'stretch' in manifest['scenes'] else 'hanging'}` and the shared numbers, and not "
        "`bending_hysteresis`, which has no response of its own; nor is the classifier trained on it. Most flexible: "
        "always `bending_hysteresis`, whose random draws give the most directions (where it is withheld: the effect "
        "that explains most at its best size). Maximum mean discrepancy (as in sbi's misspecification test) of "
        "residuals from draws of the noise as it is modelled, with its correlations and unknown scale, names nothing; "
        f"it alarms at p < 0.05 in {_mmd_line(answers)}.",
        "",
        "## Calibration (none, named and wrong-parameter cases)",
        "",
        "| stated probability of the answer | cases | right |",
        "|---|---|---|",
        *(f"| {low:.2f} to {high:.2f} | {n} | {right:.2f} |" for low, high, n, right in score.calibration if n),
        "",
        "## Confusion (what is in it -> what was answered)",
        "",
        *_confusion(answers),
        "",
        "## Every case",
        "",
        "| case | kind | in it | answered | p | named | gap p-value |",
        "|---|---|---|---|---|---|---|",
        *(_row(a) for a in answers),
        "",
    ]
    return "\n".join(lines)


def _mmd_line(answers: Sequence[Answer]) -> str:
    parts = []
    for kind in ("named", "none"):
        own = [a for a in answers if a.kind == kind]
        if own:
            alarmed = sum(a.baselines["mmd_p"] < 0.05 for a in own)
            parts.append(f"{alarmed} of {len(own)} {kind} cases")
    return " and ".join(parts) or "no case"


def _confusion(answers: Sequence[Answer]) -> list[str]:
    counts = Counter((_content(a), a.top) for a in answers)
    return [
        "| in it | answered | cases |",
        "|---|---|---|",
        *(f"| {truth} | {top} | {n} |" for (truth, top), n in sorted(counts.items())),
    ]


def _content(answer: Answer) -> str:
    if answer.kind == "wrong_parameter":
        wrong = answer.label["wrong_parameter"]
        return f"{wrong['name']} x {wrong['factor']:.2f} in one fabric"
    return " + ".join(answer.truth) or "nothing"


def _row(answer: Answer) -> str:
    cause, gap = answer.report["cause"], answer.report["gap"]
    p = cause["probabilities"][answer.top]
    return (
        f"| {answer.name} | {answer.kind} | {_content(answer)} | {answer.top} | {p:.2f} "
        f"| {', '.join(answer.named) or '-'} | {gap['p_value']:.2g} |"
    )
