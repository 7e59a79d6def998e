"""After a case was diagnosed: what the found and the true effect close on captures that were sealed with the label."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from capture.capture_set import CaptureSet
from diagnosis.afresh.fresh import FreshLook, Sized
from diagnosis.blind.places import at_a_tried_place
from diagnosis.diagnose import DiagnosisOptions
from diagnosis.effect import SCALAR
from diagnosis.effects import get_effect
from diagnosis.extension import SimulatorExtension
from diagnosis.inference.block import make_block, make_pixel_block
from diagnosis.inference.noise import NoiseModel
from diagnosis.report import GapReport
from diagnosis.shrinkage.held_out import Judge, hold_out, numbers_left
from diagnosis.shrinkage.shares import fraction_of
from diagnosis.simulation.drape_cache import DrapeCache
from diagnosis.simulation.simulator import Simulator
from diagnosis.tasks.fabric_task import explain_fabric, with_grip
from diagnosis.tasks.preparation import prepare_tasks
from simcore.errors import InputError
from simcore.parameters import ESTIMATED_NAMES

RESOLUTION_M = DiagnosisOptions().resolution_m


def verify(
    folder: Path, label: Mapping[str, Any], report: Mapping[str, Any], cache: DrapeCache
) -> dict[str, Any] | None:
    """Share of the gap that the report's effects close on further captures, and what the true ones at true size do.

    Args:
        folder: further captures.
        label: opened.
        report: of the diagnosis.
        cache: of simulations.

    Returns:
        ``fraction``, ``true_fraction``, ``covered`` (the stated 90 % interval holds ``fraction``) and
        ``parameter_error`` (root mean square of the parameters' relative error as stated, refitted without and with the
        effect); None where the label holds no further captures.

    Raises:
        InputError: the further captures are not those that were sealed.
    """
    hashes = label.get("further_captures_sha256") or {}
    if not hashes:
        return None
    for name, wanted in hashes.items():
        path = folder / name
        if not path.is_file() or hashlib.sha256(path.read_bytes()).hexdigest() != wanted:
            raise InputError(f"{path}: not the capture that was sealed", code="blind_label_changed")
    found = [(e.name, e.size) for e in SimulatorExtension.of(GapReport.model_validate(report)).effects]
    truth = [(e["name"], _size(e)) for e in label["effects"]]
    shrinkage = report["shrinkage"]
    in_numbers = shrinkage is not None and shrinkage["unit"] != "mm"
    floor = 1e-3 * (report["gap"]["noise_floor"] if shrinkage is None or in_numbers else shrinkage["repeats"])
    held_m = report.get("pin_radius_m")  # how magnets were found to hold, where not as stated
    close = partial(closed, folder, cache=cache, in_numbers=in_numbers, floor_m=floor)
    fraction, true_fraction = (
        close((found, truth)) if held_m is None else (*close((found,), pin_radius_m=held_m), *close((truth,)))
    )
    covered = None
    if shrinkage is not None:
        low, high = shrinkage["interval_90"]
        covered = bool(low <= fraction <= high)
    return {
        "fraction": fraction,
        "true_fraction": true_fraction,
        "covered": covered,
        "parameter_error": _parameter_error(label, shrinkage, folder),
    }


def closed(
    folder: Path,
    explanations: Sequence[Sequence[Sized]],
    cache: DrapeCache,
    *,
    in_numbers: bool,
    floor_m: float,
    pin_radius_m: float | None = None,
) -> list[float]:
    """Share of the gap above a floor that each explanation closes on a folder's captures.

    Args:
        folder: of a capture set.
        explanations: effects with their sizes.
        cache: of simulations.
        in_numbers: judged by the numbers that all captures share, not by the cloth's shape.
        floor_m: the shape's floor [m].
        pin_radius_m: what magnets hold round a corner; None: as the set states.
    """
    names = sorted({name for one in explanations for name, _ in one}) if in_numbers else []
    cache = replace(cache, learns=False)  # cases that are not diagnosed yet must not start from these captures' folds
    tasks, _ = prepare_tasks(CaptureSet.load(folder), names, RESOLUTION_M)
    if pin_radius_m is not None:
        tasks = [with_grip(task, pin_radius_m) for task in tasks]
    results = [explain_fabric(task, cache) for task in tasks]
    noise = NoiseModel()
    if in_numbers:
        pixels = make_pixel_block([c for r in results for c in r.captures], noise)
        before = numbers_left(pixels, [])
        tried = [[(name, at_a_tried_place(name, size)) for name, size in one] for one in explanations]
        return [fraction_of(np.array([[before, numbers_left(pixels, one), 1.0]])) for one in tried]
    looks = {r.task.id: FreshLook(Simulator(cache), r) for r in results}
    blocks = [make_block(r.captures, r.task.relative_sigma, noise) for r in results]
    shares = []
    for one in explanations:
        rows = np.stack([hold_out(block, one, None, Judge(looks)).squares[-1] for block in blocks])
        rows[:, 2] = floor_m**2
        shares.append(fraction_of(rows))
    return shares


def _size(effect: Mapping[str, Any]) -> dict[str, float]:
    """Of a label's effect, its place included."""
    magnitude = effect["magnitude"]
    size = dict(magnitude) if isinstance(magnitude, dict) else {SCALAR: magnitude, **effect.get("place", {})}
    return get_effect(effect["name"]).size(size)


def _parameter_error(
    label: Mapping[str, Any], shrinkage: Mapping[str, Any] | None, folder: Path
) -> tuple[float, float, float] | None:
    if shrinkage is None or not shrinkage["parameters"]:
        return None
    stated = {f.id: f.parameters for f in CaptureSet.load(folder).document.fabrics}
    rows = []
    for one in shrinkage["parameters"]:
        true, said = label["parameters"][one["fabric"]], stated[one["fabric"]]
        if said is None:
            continue
        versions = (said.model_dump(), one["before"], one["after"])
        rows.append([[np.log(version[name] / true[name]) ** 2 for name in ESTIMATED_NAMES] for version in versions])
    if not rows:
        return None
    as_stated, without, with_effect = np.sqrt(np.mean(np.array(rows), axis=(0, 2)))
    return float(as_stated), float(without), float(with_effect)
