"""`drapemeter estimate`: the fabrics' mechanics from a capture set."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from services import console
from services.cli.options import JSON, SEED_FIXED
from services.estimates import estimate_fields, poses_note, simulated_fields
from simcore.errors import InputError
from simcore.parameters import ESTIMATED_NAMES, UNITS

if TYPE_CHECKING:
    from capture.capture_set import CaptureSet
    from capture.prepare import PreparedCapture
    from diagnosis.extension import SimulatorExtension
    from diagnosis.indirect_estimate import IndirectEstimate
    from trainer.predict import Estimate, Estimator

    EstimateOne = Callable[[str, float], tuple[Estimate, IndirectEstimate | None]]


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("estimate")(estimate)


def estimate(
    capture_set: Path = typer.Argument(..., help="Capture set: a folder with captures.json."),
    density: float | None = typer.Option(None, "--density", help="kg/m², of fabrics whose density the set lacks."),
    model: Path | None = typer.Option(None, "--model", help="Model folder; default: the one that ships."),
    simulator: Path | None = typer.Option(
        None,
        "--simulator",
        help="simulator.json of `drapemeter diagnose --apply`: the captures show the effects in it.",
    ),
    seed: int = SEED_FIXED,
    json_output: bool = JSON,
) -> None:
    """Estimate stretch and bending stiffness of every fabric in a capture set, from any of its scenes.

    The density comes from the set, else from --density (g/m² divided by 1000). Intervals cover the truth for 90 % of
    synthetic fabrics held out of training; a fabric marked out of distribution is unlike those, whatever its intervals.
    What speaks against the poses that were found in its pictures is noted below it.

    With --simulator two dozen simulations a fabric, with the effects that a diagnosis found in the same rig, are shown
    to the same network, and the parameters are sought of which it says the same as of the captures; intervals widen by
    what the estimates move.

    \b
    Example:
      drapemeter estimate my-captures --density 0.2 --json
      drapemeter estimate my-captures --simulator report/simulator.json
    """
    from capture.capture_set import CaptureSet
    from capture.pose_notes import PoseNotes
    from capture.prepare import prepare_all
    from trainer.predict import Estimator, check_density

    extension = None if simulator is None else _extension(simulator)
    if density is not None:
        check_density(density)
    captures = CaptureSet.load(capture_set)
    densities = fabric_densities(captures, density)
    estimator, notes = Estimator.load(model), PoseNotes()
    heard = notes.heard(prepare_all(captures.captures))
    one = _plainly(estimator, heard) if extension is None else _simulated(captures, heard, extension, estimator)
    fabrics = []
    with console.progress("estimating", total=len(densities)) as bar:
        for fabric_id, value in densities.items():
            found, simulated = one(fabric_id, value)
            fabrics.append((fabric_id, value, found, notes.of_fabric(fabric_id), simulated))
            bar.advance()
    if density is not None and (stated := [n for n in densities if captures.fabrics[n].density is not None]):
        console.note(f"--density is not used for {', '.join(stated)}: the set states it")
    if json_output:
        units = {name: UNITS[name] for name in ESTIMATED_NAMES}
        documents = [as_document(*entry) for entry in fabrics]
        whole = {"fabrics": documents, "units": units, "model_version": estimator.version}
        if extension is not None:
            whole["simulator"] = extension.model_dump(mode="json")
        console.emit_json(whole)
        return
    for entry in fabrics:
        print_fabric(*entry)
    console.say(f"model {estimator.version}")


def _extension(path: Path) -> SimulatorExtension:
    from diagnosis.extension import SimulatorExtension  # it takes long, and plain estimates need none

    return SimulatorExtension.load(path)


def _plainly(estimator: Estimator, prepared: Iterable[PreparedCapture]) -> EstimateOne:
    """As the network says of the captures."""
    from capture.prepare import inputs_by_fabric

    inputs = inputs_by_fabric(prepared)
    return lambda fabric, density: (estimator.estimate_named(fabric, inputs[fabric], density), None)


def _simulated(
    captures: CaptureSet, prepared: Iterable[PreparedCapture], extension: SimulatorExtension, estimator: Estimator
) -> EstimateOne:
    """With the effects in the simulations."""
    from diagnosis.indirect_estimate import IndirectEstimator
    from diagnosis.simulation.drape_cache import DrapeCache
    from diagnosis.simulation.simulator import Simulator

    cache = DrapeCache.default()
    indirect = IndirectEstimator(captures, prepared, extension, estimator, Simulator(cache))
    for note in poses_note(indirect.in_poses):
        console.note(note)

    def estimate_one(fabric: str, density: float) -> tuple[Estimate, IndirectEstimate | None]:
        found = indirect.estimate(fabric, density)
        cache.trim()
        return found.estimate, found

    return estimate_one


def fabric_densities(captures: CaptureSet, default: float | None) -> dict[str, float]:
    """Density of each fabric that has captures [kg/m²]: the set's own, else the default.

    Raises:
        InputError: a fabric has neither, or the set shows no fabric at all.
    """
    shown = {capture.fabric.id for capture in captures.captures}
    if not shown:
        raise InputError(f"{captures.folder}: the set lists no captures", code="no_captures")
    if unseen := [name for name in captures.fabrics if name not in shown]:
        console.note(f"no captures of {', '.join(unseen)}: nothing is estimated for it")
    densities: dict[str, float] = {}
    missing = []
    for fabric_id, fabric in captures.fabrics.items():
        if fabric_id not in shown:
            continue
        value = default if fabric.density is None else fabric.density
        if value is None:
            missing.append(fabric_id)
        else:
            densities[fabric_id] = value
    if missing:
        raise InputError(
            f"no density for fabric {', '.join(missing)}: weigh a 10 x 10 cm sample and give --density in kg/m² "
            "(grams over 10), or write it into captures.json",
            code="density_missing",
        )
    return densities


def as_document(
    fabric_id: str, density: float, found: Estimate, notes: Sequence[str], simulated: IndirectEstimate | None = None
) -> dict[str, Any]:
    """One fabric's entry of the JSON document."""
    document = {
        "id": fabric_id,
        "density": density,
        **estimate_fields(found, notes),
        "out_of_distribution_score": round(found.out_of_distribution_score, 4),
    }
    return document if simulated is None else {**document, "simulated": simulated_fields(simulated)}


def print_fabric(
    fabric_id: str, density: float, found: Estimate, notes: Sequence[str], simulated: IndirectEstimate | None = None
) -> None:
    """One fabric's table, with what speaks against it."""
    console.say(f"{fabric_id}: {density:g} {UNITS['density']}, from {' and '.join(found.scenes)}")
    for name in ESTIMATED_NAMES:
        low, high = found.intervals_90[name]
        first = "" if simulated is None else f", {simulated.first.parameters[name]:.3g} without the effects"
        console.say(f"  {name:13s} {found.parameters[name]:9.3g} {UNITS[name]:4s} 90 %: {low:.3g} to {high:.3g}{first}")
    if simulated is not None:
        rest = f", {simulated.unrested} of them not at rest" if simulated.unrested else ""
        console.say(
            f"  {simulated.simulations} simulations with the effects{rest}: the network's word on the last differs by "
            f"{simulated.left:.2g} in ln p from that on the captures"
        )
    if not found.intervals_calibrated:
        console.say("  the intervals promise nothing: the model was calibrated on too few fabrics")
    if found.reasons:
        console.say(f"  out of distribution, do not rely on the estimate: {'; '.join(found.reasons)}")
    if found.picture_score > 1.0:
        console.say(
            "  out of distribution: these captures are unlike the training pictures "
            f"(score {found.picture_score:.2f}, border 1); do not rely on the intervals"
        )
    for note in notes:
        console.say(f"  {note}")
