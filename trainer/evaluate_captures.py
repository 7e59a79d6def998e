"""How good a model is on captures of fabrics whose parameters are known, as in the paper's table of real samples.

python -m trainer.evaluate_captures --model model/ captures-1/ captures-2/ --out scores.json
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capture.capture_set import CaptureSet
from capture.normalise import NetworkInput
from capture.pose_notes import PoseNotes
from capture.prepare import prepare_all
from renderer.atomic import write_atomically
from simcore.errors import InputError
from simcore.parameters import ESTIMATED_NAMES
from simcore.scenes import Scene
from trainer.evaluate import Score, number_text, rank_correlation
from trainer.predict import Estimate, Estimator
from trainer.program import told_in_one_line


@dataclass(frozen=True)
class KnownFabric:
    """A fabric with captures and known mechanics.

    Attributes:
        name: capture set and fabric.
        density: [kg/m²].
        parameters: the six, SI, float64, shape [6].
        inputs: its captures by scene.
        notes: in words, what speaks against the poses of its captures.
    """

    name: str
    density: float
    parameters: NDArray[np.float64]
    inputs: dict[Scene, list[NetworkInput]]
    notes: tuple[str, ...] = ()


def known_fabrics(folders: Iterable[str | Path]) -> list[KnownFabric]:
    """Every fabric of some capture sets that states its parameters and density.

    Raises:
        InputError: a set that cannot be read, or no such fabric in any.
    """
    found = []
    for folder in folders:
        captures = CaptureSet.load(folder, read_pictures=False)
        notes = PoseNotes()
        ready = list(notes.heard(prepare_all(captures.captures)))  # poses are found from all captures of a set together
        for fabric in captures.document.fabrics:
            shown = [prepared for prepared in ready if prepared.capture.fabric.id == fabric.id]
            if fabric.parameters is None or fabric.density is None or not shown:
                continue
            inputs: dict[Scene, list[NetworkInput]] = {}
            for prepared in shown:
                inputs.setdefault(prepared.capture.scene, []).append(prepared.network_input)
            truth = np.array([getattr(fabric.parameters, name) for name in ESTIMATED_NAMES], dtype=np.float64)
            name = f"{captures.folder.name}/{fabric.id}"
            found.append(KnownFabric(name, fabric.density, truth, inputs, notes.of_fabric(fabric.id)))
    if not found:
        raise InputError(
            "no fabric of these capture sets states both parameters and density: nothing to compare with",
            code="no_known_fabrics",
        )
    return found


def evaluate_captures(estimator: Estimator, fabrics: list[KnownFabric]) -> dict[str, dict[str, Score]]:
    """Scores by set of scenes and parameter, over the fabrics that show all scenes of the set.

    ``mae_range`` is relative to the range of the fabrics themselves.

    Raises:
        InputError: a fabric's captures cannot be estimated from; the message names it.
    """
    scores: dict[str, dict[str, Score]] = {}
    for scenes in ((Scene.HANGING,), (Scene.STRETCH,), (Scene.HANGING, Scene.STRETCH)):
        usable = [fabric for fabric in fabrics if all(scene in fabric.inputs for scene in scenes)]
        if usable:
            estimates = [estimator.estimate_named(f.name, {s: f.inputs[s] for s in scenes}, f.density) for f in usable]
            scores["+".join(scene.value for scene in scenes)] = _scores(usable, estimates)
    return scores


def _scores(fabrics: list[KnownFabric], estimates: list[Estimate]) -> dict[str, Score]:
    truth = np.stack([fabric.parameters for fabric in fabrics])
    result = {}
    promised = all(estimate.intervals_calibrated for estimate in estimates)
    for k, name in enumerate(ESTIMATED_NAMES):
        values = np.array([estimate.parameters[name] for estimate in estimates])
        ends = np.array([estimate.intervals_90[name] for estimate in estimates])
        span = float(np.ptp(truth[:, k])) or math.nan  # one fabric has no range
        result[name] = Score(
            mae_log=float(np.abs(np.log(values / truth[:, k])).mean()),
            mae_range=float(np.abs(values - truth[:, k]).mean() / span),
            spearman=rank_correlation(values, truth[:, k]),
            coverage=_covered(ends, truth[:, k]) if promised else math.nan,
            interval_factor=float(np.median(ends[:, 1] / ends[:, 0])) if promised else math.nan,
        )
    return result


def _covered(ends: NDArray[np.float64], truth: NDArray[np.float64]) -> float:
    return float(((ends[:, 0] <= truth) & (truth <= ends[:, 1])).mean())


def markdown(scores: dict[str, dict[str, Score]]) -> str:
    """A row a parameter; typical factor, Spearman and coverage for each set of scenes."""
    lines = ["| parameter | " + " | ".join(f"{scenes}: factor | r | covered" for scenes in scores) + " |"]
    lines.append("|---" * (1 + 3 * len(scores)) + "|")
    for name in ESTIMATED_NAMES:
        cells = [
            f"{math.exp(s[name].mae_log):.2f} | {number_text(s[name].spearman)} | {number_text(s[name].coverage)}"
            for s in scores.values()
        ]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def as_json(scores: dict[str, dict[str, Score]]) -> dict[str, dict[str, dict[str, float | None]]]:
    """As plain JSON values; what is relative to the range of the fabrics themselves is called so, ``mae_own_range``."""
    return {
        scenes: {
            name: {"mae_own_range" if key == "mae_range" else key: value for key, value in score.to_json().items()}
            for name, score in rows.items()
        }
        for scenes, rows in scores.items()
    }


def main() -> None:
    """Print the table, and on standard error what speaks against the poses; write the numbers if asked."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("captures", nargs="+", help="capture sets")
    parser.add_argument("--model", help="model folder; default: the one that ships")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    with told_in_one_line():
        if options.out is not None and not options.out.absolute().parent.is_dir():
            raise InputError(f"{options.out}: no such folder: make it, or name another file", code="folder_unusable")
        if options.out is not None and options.out.is_dir():
            raise InputError(f"{options.out} is a folder: name a file", code="output_is_folder")
        fabrics = known_fabrics(options.captures)
        for fabric in fabrics:
            sys.stderr.writelines(f"{fabric.name}: {note}\n" for note in fabric.notes)
        scores = evaluate_captures(Estimator.load(options.model), fabrics)
        sys.stdout.write(markdown(scores) + "\n")
        if options.out is not None:
            write_atomically(options.out, (json.dumps(as_json(scores), indent=1) + "\n").encode())


if __name__ == "__main__":
    main()
