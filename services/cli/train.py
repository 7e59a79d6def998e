"""`drapemeter train`: a model from a store."""

from __future__ import annotations

import math
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from services import console
from services.cli.options import JSON
from services.cli.outputs import check_folder
from simcore.errors import DrapemeterError, InputError

if TYPE_CHECKING:
    from trainer.checkpoint import CheckpointFile
    from trainer.config import TrainConfig
    from trainer.model import TrainedModel
    from trainer.train import Progress


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("train")(train)


def train(
    store: list[str] = typer.Option(
        ..., "--store", help="Store of drapes: folder or URL; several to learn from all of them."
    ),
    out: Path = typer.Option(..., "--out", help="Model folder to write; an earlier model there is replaced."),
    preset: str = typer.Option("standard", "--preset", help="standard, paper or quick: see docs/estimator.md."),
    epochs: int | None = typer.Option(None, "--epochs", help="Passes over the training pictures."),
    input_size: int | None = typer.Option(None, "--input-size", help="Edge of the input [pixel]: 32, 64, 128 or 256."),
    trunk_width: float | None = typer.Option(None, "--trunk-width", help="Channels as a share of ResNet-18's."),
    pictures: int | None = typer.Option(None, "--pictures", help="Pictures of an epoch, at most; 0 = all."),
    pretrained: bool | None = typer.Option(None, "--pretrained/--scratch", help="Start from ImageNet weights."),
    start: Path | None = typer.Option(None, "--start", help="Model to go on from, with its network and scaling."),
    resume: bool = typer.Option(
        False, "--resume", help="Go on with the training for --out that was interrupted; all other options as then."
    ),
    seed: int = typer.Option(0, "--seed", help="Of split, weights, order and augmentation."),
    threads: int = typer.Option(1, "--threads", help="CPU threads of the network."),
    workers: int = typer.Option(0, "--workers", help="Processes that read the store; 0 = this one."),
    ranks: int = typer.Option(0, "--ranks", help="Train as a job on Ray, on so many workers; 0 = in this process."),
    address: str | None = typer.Option(
        None, "--address", help="Ray cluster for --ranks; default: RAY_ADDRESS, else a local one."
    ),
    tensorboard: Path | None = typer.Option(
        None, "--tensorboard", help="Folder for TensorBoard events; default: none."
    ),
    json_output: bool = JSON,
) -> None:
    """Train the estimator, calibrate its intervals and test it on fabrics held out of training.

    The same stores, options and seed give the same model. Training starts from scratch unless
    --pretrained or --preset paper, which takes ImageNet weights unless --scratch.

    Now and then its state is kept beside the model's place, in a file OUT.checkpoint that is gone when the model is
    written. An interrupted training goes on from it with --resume, to the same model as one that was not. With --ranks
    nothing is kept.

    \b
    Example:
      drapemeter train --store store.zarr --out model/ --epochs 10
      drapemeter train --store store.zarr --out model/ --epochs 10 --resume
    """
    from trainer.checkpoint import CheckpointFile, checkpoint_place
    from trainer.model import load_model
    from trainer.presets import preset_config
    from trainer.tracking import TensorBoardLog

    asked = {
        "epochs": epochs,
        "pictures_per_epoch": pictures,
        "pretrained": pretrained,
        "seed": seed,
        "threads": threads,
        "workers": workers,
    }
    config = preset_config(preset).with_values(asked, {"input_size": input_size, "trunk_width": trunk_width})
    if start is not None and not (input_size is None and trunk_width is None and pretrained is None):
        raise InputError(
            "--start brings its network and weights: leave out --input-size, --trunk-width and --pretrained",
            code="options_exclude",
        )
    if address is not None and not ranks:
        raise InputError("--address is for --ranks: say on how many workers", code="options_exclude")
    if resume and ranks:
        raise InputError(
            "--resume is for a training in one process, of one on --ranks nothing is kept: leave out one of them",
            code="options_exclude",
        )
    check_out(out)
    checkpoints = CheckpointFile(checkpoint_place(out), resume, console.note)
    checkpoints.check()
    if tensorboard is not None:
        check_folder(tensorboard, "give --tensorboard another folder")
        if tensorboard.resolve().is_relative_to(out.resolve()):
            raise InputError(f"{tensorboard} lies in {out}, which is replaced: give another", code="output_twice")
    earlier = load_model(start) if start is not None else None
    started = time.monotonic()
    with told_how_to_go_on(checkpoints), ExitStack() as stack:
        show = show_on(stack.enter_context(console.progress("training")))
        log: TensorBoardLog | None = None
        if tensorboard is not None:
            log = stack.enter_context(TensorBoardLog(tensorboard, show, console.note))
        model = run(store, config, earlier, ranks, address, show if log is None else log.report, checkpoints)
        version = save(model, out)
        checkpoints.remove()
        if log is not None:
            log.finish(model.metrics)
    report(model, out, version, time.monotonic() - started, json_output)


@contextmanager
def told_how_to_go_on(checkpoints: CheckpointFile) -> Iterator[None]:
    """Tell of the checkpoint, where there is one, when a training is interrupted or fails."""
    try:
        yield
    except BaseException:
        if checkpoints.step:
            console.note(f"{checkpoints.path}: kept behind step {checkpoints.step}; --resume goes on from there")
        raise


def save(model: TrainedModel, out: Path) -> str:
    """Write the model; where that fails by now, among the temporary files, so that the training is not lost.

    Raises:
        DrapemeterError: it lies elsewhere, which the message tells, or could be written nowhere.
    """
    try:
        return model.save(out)
    except DrapemeterError as error:
        if error.code == "model_not_replaced":  # then it is beside what could not be
            raise
        kept = Path(tempfile.mkdtemp(prefix="drapemeter-model-"))
        try:
            model.save(kept)
        except DrapemeterError:
            kept.rmdir()
            raise error from None
        raise DrapemeterError(f"{error}; the trained model is in {kept}", code=error.code) from error


def check_out(out: Path) -> None:
    """Refuse early what could not be written after the training.

    Raises:
        InputError: something other than a model is there.
    """
    from trainer.model import check_target

    if out.resolve() == Path.cwd():
        raise InputError("the folder that one is in cannot be replaced: name a folder in it", code="output_exists")
    check_target(out)
    if not out.absolute().parent.is_dir():
        raise InputError(f"{out}: its folder does not exist; make it first", code="folder_missing")
    check_folder(out, "give another folder for the model")
    target = Path(os.path.realpath(out))
    if target.is_mount():
        raise InputError(
            f"{out} is where a disk is mounted, and no folder that can be replaced: name one in it",
            code="output_exists",
        )
    check_folder(target.parent, "a model takes its place by a rename there; give another folder for it")


def show_on(bar: console.ProgressBar) -> Callable[[Progress], None]:
    """What moves the progress bar."""

    def show(progress: Progress) -> None:
        text = f"training, squared error {progress.loss:.3f}"
        bar.update(completed=progress.step, total=progress.steps, description=text)

    return show


def run(
    stores: Sequence[str],
    config: TrainConfig,
    start: TrainedModel | None,
    ranks: int,
    address: str | None,
    report_step: Callable[[Progress], None],
    checkpoints: CheckpointFile,
) -> TrainedModel:
    """Train here or on Ray, from scratch or from an earlier model; of a training on Ray no state is kept."""
    from services.training.job import train_on_ray
    from trainer.several_stores import open_stores
    from trainer.symmetry import as_symmetric
    from trainer.train import train as train_here

    source = open_stores(stores, config.inclinations)
    asked, config = config, as_symmetric(config, source.provenance())
    if config != asked:
        console.note("pictures are not mirrored: the simulator of these drapes has effects that may be one-sided")
    if ranks:
        return train_on_ray(stores, config, ranks=ranks, address=address, start=start, report=report_step)
    provenance = source.provenance()
    return train_here(source, config, start=start, provenance=provenance, report=report_step, checkpoints=checkpoints)


def report(model: TrainedModel, out: Path, version: str, seconds: float, json_output: bool) -> None:
    """Print how good it is."""
    if json_output:
        console.emit_json(
            {
                "model": out,
                "model_version": version,
                "seconds": round(seconds, 1),
                "config": model.config.to_json(),
                "metrics": model.metrics.to_json(),
            }
        )
        return
    from trainer.evaluate import number_text
    from trainer.split import CALIBRATION_MATERIALS

    counts = model.metrics.materials
    console.say(
        f"{out}: model {version}, {seconds:.0f} s; fabrics learnt from {counts['train']}, calibrated on "
        f"{counts['calibration']}, tested on {counts['test']}"
    )
    if counts["calibration"] < CALIBRATION_MATERIALS:
        new = " that the earlier model does not know" if "start" in model.provenance else ""
        console.say(
            f"  its intervals promise nothing: that takes {CALIBRATION_MATERIALS} fabrics{new} to calibrate on, "
            f"a store of {5 * CALIBRATION_MATERIALS} or more"
        )
    for predictor in model.metrics.scores:
        factor = math.exp(model.metrics.average(predictor, "mae_log"))
        correlation = number_text(model.metrics.average(predictor, "spearman"))
        coverage = model.metrics.average(predictor, "coverage")
        covered = "" if math.isnan(coverage) else f", 90 % intervals cover {100 * coverage:.0f} %"
        console.say(f"  {predictor:16s} off by a factor {factor:.2f}, rank correlation {correlation}{covered}")
