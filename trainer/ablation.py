"""The paper's ablation as a ladder of configurations, and which inputs matter; one command trains them all.

    python -m trainer.ablation --store store.zarr --out ablation/

Source: the paper's tables "Ablation study" and "Results varying the input".
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

from renderer.atomic import write_atomically
from simcore.errors import InputError
from trainer.config import AugmentConfig, TrainConfig
from trainer.dataset import SCENES, Partition, PictureSource, PictureTable
from trainer.evaluate import Metrics, evaluate, number_text
from trainer.presets import preset_config
from trainer.pretrained import find_pretrained
from trainer.program import make_results_folder, told_in_one_line
from trainer.symmetry import as_symmetric, is_symmetric
from trainer.train import split_of, steps_of, train, training_pictures


def ladder(base: TrainConfig, *, pretrained: bool, mirrored: bool = True) -> dict[str, TrainConfig]:
    """From the paper's baseline upwards, each step adding to the one before; then this project's own steps.

    Args:
        base: sizes, length and seed of every run.
        pretrained: include ImageNet weights (full trunk only); without them that step is left out.
        mirrored: include mirrored pictures, which show the same of a symmetric simulator alone.
    """
    plain = replace(base.network, attention=False, average_pooling=False, height_channel=False, targets="log")
    step = replace(
        base,
        network=plain,
        augment=AugmentConfig.off(),
        inclinations="upright",
        pretrained=False,
        fusion_training="single",
        mirror=0.0,
    )
    steps = {"baseline": step}
    steps["+ simulation augmentation"] = step = replace(step, inclinations="as_seen")
    steps["+ image augmentation"] = step = replace(step, augment=AugmentConfig())
    if pretrained:
        steps["+ pre-training"] = step = replace(step, pretrained=True)
    steps["+ attention"] = step = replace(step, network=replace(step.network, attention=True))
    steps["+ average pooling (paper)"] = step = replace(step, network=replace(step.network, average_pooling=True))
    steps["+ registered heights"] = step = replace(step, inclinations="registered")
    steps["+ fused training"] = step = replace(step, fusion_training="subsets")
    steps["+ targets over weight"] = step = replace(step, network=replace(step.network, targets="log_per_weight"))
    steps["+ height channel"] = step = replace(step, network=replace(step.network, height_channel=True))
    if mirrored:
        steps["+ mirrored hanging"] = replace(step, mirror=0.5)
    return steps


def input_influence(base: TrainConfig) -> dict[str, TrainConfig]:
    """Depth alone against depth and density; density alone is among every run's metrics."""
    blind = replace(base.network, use_density=False, targets="log")
    return {"depth": replace(base, network=blind), "density and depth": base}


def run(
    source_by_inclination: Mapping[str, PictureSource],
    configs: Mapping[str, TrainConfig],
    keep: Callable[[dict[str, Metrics]], None] = lambda results: None,
) -> dict[str, Metrics]:
    """Train every configuration on the same split, for as many steps, and test it on the same upright pictures.

    Args:
        source_by_inclination: the pictures, by ``TrainConfig.inclinations``.
        configs: by name.
        keep: told all results so far after each.
    """
    results: dict[str, Metrics] = {}
    for name, config in configs.items():
        sys.stderr.write(f"training: {name}\n")
        source = source_by_inclination[config.inclinations]
        pictures = source.table()
        model = train(source, as_long(config, pictures))
        split = split_of(pictures, config)
        results[name] = evaluate(model.network, source, pictures.upright(), split, model.scaling, model.intervals)
        keep(results)
    return results


def as_long(config: TrainConfig, pictures: PictureTable) -> TrainConfig:
    """The same with as many steps as on all pictures: upright ones alone are fewer, and would be learnt from for less
    long, which is no property of them.
    """
    split = split_of(pictures, config)
    own, whole = (
        steps_of(training_pictures(pictures, split, taught), taught, Partition())
        for taught in (config, replace(config, inclinations="registered"))
    )
    return replace(config, epochs=max(1, round(config.epochs * whole / own)))


def table(results: Mapping[str, Metrics], predictor: str = "hanging+stretch") -> str:
    """Markdown: a row a configuration; error over the training range (paper's), typical factor and Spearman. Dashes
    where no tested fabric shows what the predictor sees.
    """
    lines = [
        "| configuration | stretch: l1 | factor | r | bending: l1 | factor | r |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, metrics in results.items():
        cells = []
        for prefix in ("stretch", "bending"):
            if predictor not in metrics.scores:
                cells += ["-"] * 3
                continue
            cells += [
                number_text(metrics.average(predictor, "mae_range", prefix), 3),
                f"{math.exp(metrics.average(predictor, 'mae_log', prefix)):.2f}",
                number_text(metrics.average(predictor, "spearman", prefix), 3),
            ]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    """Train the ladder and the input comparison on a store; write `ablation.json` and `ablation.md`."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--store", required=True)
    parser.add_argument("--out", required=True, type=Path)
    parser.add_argument("--preset", default="quick", help="sizes and length of every run")
    parser.add_argument("--epochs", type=int)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--pretrained", action="store_true", help="include ImageNet weights (full trunk)")
    options = parser.parse_args()
    with told_in_one_line():
        _run(options)


def _run(options: argparse.Namespace) -> None:
    from trainer.store_source import StoreSource

    asked = {"epochs": options.epochs, "seed": options.seed, "pretrained": options.pretrained}
    base = preset_config(options.preset).with_values(asked, {})
    if options.pretrained and base.network.trunk_width != 1.0:
        raise InputError(
            f"ImageNet weights are for the full trunk, preset {options.preset} has {base.network.trunk_width} of it: "
            "give --preset standard or paper",
            code="trunk_width",
        )
    if options.pretrained:
        find_pretrained()
    source = StoreSource(options.store)
    base, mirrored = as_symmetric(base, source.provenance()), is_symmetric(source.provenance())
    shown = set(source.table().scene.tolist())
    lacking = [scene.value for place, scene in enumerate(SCENES) if place not in shown]
    if lacking:
        raise InputError(
            f"{options.store} lacks usable pictures of {' and '.join(lacking)}: the ablation compares both scenes",
            code="scene_missing",
        )
    make_results_folder(options.out)
    sources: dict[str, PictureSource] = {
        "upright": StoreSource(options.store),
        "registered": StoreSource(options.store),
        "as_seen": StoreSource(options.store, "as_seen"),
    }
    steps = run(
        sources,
        ladder(base, pretrained=options.pretrained, mirrored=mirrored),
        lambda done: write(options.out, done, {}),
    )
    run(sources, input_influence(base), lambda done: write(options.out, steps, done))


def write(out: Path, steps: Mapping[str, Metrics], inputs: Mapping[str, Metrics]) -> None:
    """`ablation.json` and `ablation.md` of what is done so far."""
    parts = ["Ablation, both scenes\n", table(steps)]
    if inputs:
        for scenes in ("hanging", "stretch", "hanging+stretch"):
            parts += [f"\nInputs: {scenes}\n", table(inputs, scenes)]
        parts += ["\nDensity alone\n", table({"density": next(iter(inputs.values()))}, "density")]
    write_atomically(out / "ablation.md", ("\n".join(parts) + "\n").encode())
    documents = {name: metrics.to_json() for name, metrics in {**steps, **inputs}.items()}
    write_atomically(out / "ablation.json", (json.dumps(documents, indent=1) + "\n").encode())


if __name__ == "__main__":
    main()
