"""The loop closed: captures with an effect, its diagnosis, a sweep with the simulator so extended, an estimator of it.

    python bench/bench_loop.py [--out loop/] [--effect hem_weight=30] [--materials 128] [--fabrics 24] [--seeds 2]

Two estimators are trained on equal sweeps, one with the plain simulator and one with the effects that the diagnosis of
a few known fabrics found, and tried on captures of other fabrics that have the effect. What is in the folder already is
not made again. Everything is simulated, the captures on another mesh than the diagnosis and the sweeps; the effect's
true size is known to the captures alone.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from results import add_json_option

from capture.capture_set import CaptureSet
from diagnosis.diagnose import DiagnosisOptions, diagnose
from diagnosis.effect import Effect, Size
from diagnosis.effects import parse_effect
from diagnosis.extension import SimulatorExtension
from diagnosis.simulation.drape_cache import DrapeCache
from diagnosis.synthesis import DIAGNOSABLE, SynthesisPlan, draw_fabrics, make_capture_set
from services.dataset.fabrics import plan_sweep
from services.dataset.sweep import run_sweep
from simcore.errors import SimulationError
from simcore.parameters import ESTIMATED_NAMES
from simcore.scenes import Scene
from trainer.evaluate_captures import KnownFabric, known_fabrics
from trainer.predict import Estimator
from trainer.presets import preset_config
from trainer.store_source import StoreSource
from trainer.symmetry import as_symmetric
from trainer.train import train

Effects = Sequence[tuple[Effect, Size]]
Errors = dict[tuple[str, int, str, str], NDArray[np.float64]]
"""Errors of ln p, shape [fabrics, 6], by model, seed of the training, captures and scenes."""
KNOWN_SEED, TEST_SEED = 501, 777
SCENE_SETS = ((Scene.HANGING,), (Scene.STRETCH,), (Scene.HANGING, Scene.STRETCH))


@dataclass(frozen=True)
class Row:
    """One estimator on one kind of captures.

    Attributes:
        captures, model, seed: which.
        scenes: seen.
        stretch, bending: mean absolute error of ln p over the three stiffnesses and all fabrics.
        stretch_signed, bending_signed: mean signed error of ln p; positive: taken for too stiff.
        covered: share of truths inside the 90 % interval.
        flagged: share of fabrics marked as unlike the training pictures.
        fabrics: how many.
    """

    captures: str
    model: str
    seed: int
    scenes: str
    stretch: float
    bending: float
    stretch_signed: float
    bending_signed: float
    covered: float
    flagged: float
    fabrics: int


def find_effects(out: Path, effects: Effects, options: argparse.Namespace) -> Path:
    """Captures of a few known fabrics with the effect, diagnosed; the file with the extended simulator."""
    file = out / "simulator.json"
    if not file.exists():
        plan = SynthesisPlan(fabrics=options.known, repeats=2, resolution_m=options.captured, seed=KNOWN_SEED)
        make_capture_set(out / "known", plan, effects, name="known")
        chosen = DiagnosisOptions(resolution_m=options.resolution)
        found = diagnose(CaptureSet.load(out / "known"), chosen, cache=DrapeCache(out / "drapes"))
        (out / "report.json").write_text(json.dumps(found.report.as_json(), indent=1))
        SimulatorExtension.of(found.report, found.pin_radius_m).save(file)
    return file


def make_tests(out: Path, effects: Effects, resolution_m: float, count: int) -> tuple[list[Path], list[Path]]:
    """Captures of fabrics of the prior without and with the effect; fabrics that do not come to rest are left out."""
    plain, changed = [], []
    plan = SynthesisPlan(repeats=1, resolution_m=resolution_m, parameters_cv=0.0, density_cv=0.0, seed=TEST_SEED)
    for number, fabric in enumerate(draw_fabrics(count, TEST_SEED)):
        pair = (out / "plain" / str(number), out / "changed" / str(number))
        try:
            for folder, on in zip(pair, ((), effects), strict=True):
                if not (folder / "captures.json").exists():
                    make_capture_set(folder, plan, on, fabrics={number: fabric}, name=f"{folder.parent.name}-{number}")
        except SimulationError as error:
            print(f"fabric {number} left out: {error}", flush=True)
            continue
        plain.append(pair[0])
        changed.append(pair[1])
    return plain, changed


def learn(out: Path, name: str, simulator: Path | None, options: argparse.Namespace) -> None:
    """A sweep and its estimators, one for each seed."""
    configuration, fabrics = plan_sweep(
        materials=options.materials,
        jitters=1,
        inclinations=5,
        resolution_m=options.resolution,
        ranges=DIAGNOSABLE,
        simulator=simulator or (),
    )
    summary = run_sweep(out / f"{name}.zarr", configuration, fabrics, workers=1, resume=True)
    print(f"{name}: {summary.samples} samples, failed {summary.failed}, {summary.seconds:.0f} s", flush=True)
    for seed in range(options.seeds):
        folder = out / f"model-{name}-{seed}"
        if not folder.exists():
            began = time.process_time()
            source = StoreSource(out / f"{name}.zarr")
            config, known = replace(preset_config("quick"), seed=seed), source.provenance()
            train(source, as_symmetric(config, known), provenance=known).save(folder)
            print(f"{folder.name}: {time.process_time() - began:.0f} CPU s", flush=True)


def log_errors(
    estimator: Estimator, fabrics: list[KnownFabric], scenes: tuple[Scene, ...]
) -> tuple[NDArray[np.float64], float, float]:
    """Errors of ln p, float64, shape [fabrics, 6]; share of truths inside their intervals; share of fabrics flagged."""
    estimates = [estimator.estimate({s: f.inputs[s] for s in scenes}, f.density) for f in fabrics]
    truth = np.stack([fabric.parameters for fabric in fabrics])
    values = np.array([[e.parameters[name] for name in ESTIMATED_NAMES] for e in estimates])
    ends = np.array([[e.intervals_90[name] for name in ESTIMATED_NAMES] for e in estimates])
    covered = ((ends[..., 0] <= truth) & (truth <= ends[..., 1])).mean()
    return np.log(values / truth), float(covered), float(np.mean([e.out_of_distribution for e in estimates]))


def compare(
    out: Path, plain: list[Path], changed: list[Path], seeds: range
) -> tuple[list[Row], dict[str, dict[str, float]]]:
    """All rows; what the effect costs the plain estimator and what the extension gains, over the fabrics."""
    sets = {"without the effect": known_fabrics(plain), "with the effect": known_fabrics(changed)}
    rows: list[Row] = []
    errors: Errors = {}
    for model in ("plain", "extended"):
        for seed in seeds:
            estimator = Estimator.load(out / f"model-{model}-{seed}")
            for name, fabrics in sets.items():
                for scenes in SCENE_SETS:
                    both = "+".join(scene.value for scene in scenes)
                    found, covered, flagged = log_errors(estimator, fabrics, scenes)
                    errors[model, seed, name, both] = found
                    rows.append(
                        Row(
                            name,
                            model,
                            seed,
                            both,
                            *_means(np.abs(found)),
                            *_means(found),
                            covered,
                            flagged,
                            len(found),
                        )
                    )
    return rows, _changes(errors, seeds)


def _changes(errors: Errors, seeds: range) -> dict[str, dict[str, float]]:
    """Mean over fabrics and its standard error of what the effect costs and what the extension gains."""
    changes = {}
    for scenes in SCENE_SETS:
        both = "+".join(scene.value for scene in scenes)
        steps = {
            "the effect costs": (("plain", "with the effect"), ("plain", "without the effect")),
            "the extension gains": (("plain", "with the effect"), ("extended", "with the effect")),
        }
        for what, (more, less) in steps.items():
            change = np.mean(
                [np.abs(errors[more[0], s, more[1], both]) - np.abs(errors[less[0], s, less[1], both]) for s in seeds],
                axis=0,
            )
            for part, columns in (("stretch", slice(0, 3)), ("bending", slice(3, 6))):
                per_fabric = change[:, columns].mean(axis=1)
                error = float(per_fabric.std(ddof=1) / np.sqrt(len(per_fabric)))
                changes[f"{what}, {both}, {part}"] = {"mean": float(per_fabric.mean()), "standard_error": error}
    return changes


def _means(values: NDArray[np.float64]) -> tuple[float, float]:
    return float(values[:, :3].mean()), float(values[:, 3:].mean())


def run(out: Path, options: argparse.Namespace) -> None:
    """Every step, then the table."""
    out.mkdir(parents=True, exist_ok=True)
    effects = [parse_effect(options.effect)]
    simulator = find_effects(out, effects, options)
    print("found:", " ".join(e.option for e in SimulatorExtension.load(simulator).effects) or "nothing", flush=True)
    plain, changed = make_tests(out, effects, options.captured, options.fabrics)
    learn(out, "plain", None, options)
    learn(out, "extended", simulator, options)
    rows, changes = compare(out, plain, changed, range(options.seeds))
    for row in rows:
        print("  ".join(f"{v:.2f}" if isinstance(v, float) else str(v) for v in asdict(row).values()))
    for name, change in changes.items():
        print(f"{name}: {change['mean']:.2f} +- {change['standard_error']:.2f} in |error of ln p|")
    options.json.write_text(json.dumps({"rows": [asdict(row) for row in rows], "changes": changes}, indent=1))


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="folder for all that is made; a later run goes on in it")
    add_json_option(parser, "loop")
    parser.add_argument("--effect", default="hem_weight=30", help="NAME=MAGNITUDE that the captures have")
    parser.add_argument("--materials", type=int, default=128, help="fabrics of each sweep")
    parser.add_argument("--known", type=int, default=4, help="fabrics that are diagnosed")
    parser.add_argument("--fabrics", type=int, default=24, help="fabrics that are estimated")
    parser.add_argument("--resolution", type=float, default=0.02, help="mesh cell of diagnosis and sweeps [m]")
    parser.add_argument("--captured", type=float, default=0.5 / 30, help="mesh cell of what is captured [m]")
    parser.add_argument("--seeds", type=int, default=2, help="trainings of each estimator")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        run(options.out or Path(folder), options)


if __name__ == "__main__":
    main()
