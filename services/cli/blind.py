"""`drapemeter blind`: check the diagnosis on capture sets whose cause is sealed."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from services import console
from services.cli.caches import drape_cache
from services.cli.options import JSON, SEED_FIXED
from services.cli.outputs import check_file, check_folder, make_folder
from services.names import split_names
from simcore.errors import InputError

if TYPE_CHECKING:
    from diagnosis.blind.answers import Answer


def register(app: typer.Typer) -> None:
    """Add the command's group."""
    blind = typer.Typer(
        help="Check the diagnosis on capture sets whose cause is sealed.\n\n\b\nExample:\n"
        "  drapemeter blind make 20 check/ --seed 7 && drapemeter blind score check/ --page check.md",
    )
    blind.command("make")(make)
    blind.command("score")(score)
    app.add_typer(blind, name="blind")


def make(
    cases: int = typer.Argument(..., help="Number of capture sets."),
    out: Path = typer.Argument(..., help="Folder for sets, labels and manifest; a stopped run goes on."),
    seed: int = typer.Option(0, "--seed", help="Of everything; use one that no tuning has seen."),
    fabrics: int = typer.Option(4, "--fabrics", help="Fabrics in a set."),
    repeats: int = typer.Option(2, "--repeats", help="Captures a fabric and scene."),
    pool: int = typer.Option(5, "--pool", help="Different fabrics in the whole check; sets share their simulations."),
    resolution: float = typer.Option(0.5 / 60, "--resolution", help="Edge of a mesh cell [m]; not the diagnosis's."),
    scenes: str = typer.Option("hanging,stretch", "--scenes", help="Of every set, comma-separated."),
    withhold: list[str] = typer.Option(
        [], "--withhold", help="Effects that the data has and the diagnosis lacks, comma-separated."
    ),
    plan_only: bool = typer.Option(False, "--plan-only", help="Only the plan: `blind score --make` makes the cases."),
    json_output: bool = JSON,
) -> None:
    """Write sealed capture sets: labels in files of their own, their hashes in the sets.

    \b
    Example:
      drapemeter blind make 20 check/ --seed 7 --withhold hem_weight,crease
    """
    from diagnosis.blind.make import BlindPlan, case_maker, make_blind_check

    left_out = split_names(",".join(withhold))
    plan = BlindPlan(cases, seed, fabrics, repeats, pool, resolution, left_out, split_names(scenes))
    plan.check()
    if out.exists() and not out.is_dir():
        raise InputError(f"{out} is a file: give a folder", code="output_is_file")
    check_folder(out, "give a folder that can be written to")
    if plan_only:
        case_maker(out, plan)
    else:
        with console.progress("simulating", total=cases) as bar:
            make_blind_check(out, plan, on_case=bar.advance)
    if json_output:
        made = 0 if plan_only else cases
        console.emit_json({"cases": cases, "made": made, "out": str(out), "seed": seed, "withhold": list(left_out)})
        return
    if plan_only:
        console.say(f"the plan of {cases} capture sets is in {out}: `drapemeter blind score {out} --make` makes them")
        return
    console.say(f"{cases} sealed capture sets in {out}")


def score(
    out: Path = typer.Argument(..., help="Folder that `blind make` wrote."),
    page: Path | None = typer.Option(None, "--page", help="Also write the result as a Markdown page."),
    workers: int = typer.Option(1, "--workers", help="Processes; each takes a fabric at a time."),
    train: Path | None = typer.Option(
        None, "--train", help="Another, scored check, to train a plain classifier on as a baseline."
    ),
    make_missing: bool = typer.Option(
        False, "--make", help="Make cases that are not there yet, one after the other, each before it is diagnosed."
    ),
    minutes: float = typer.Option(0.0, "--minutes", min=0.0, help="Begin no further case after this time; 0: do all."),
    seed: int = SEED_FIXED,
    json_output: bool = JSON,
) -> None:
    """Diagnose all sealed sets without their labels, then open the labels and count.

    Reports are kept beside the sets, so a stopped run goes on, and several may run at once, each with cases that no
    other has; simulations are kept in the cache folder. What is reported is all that is done by then.

    \b
    Example:
      drapemeter blind score check/ --page check.md
    """
    from diagnosis.blind.answers import REPORTS_FOLDER, examples_of, read_manifest
    from diagnosis.blind.page import render_page
    from diagnosis.blind.score import score as count
    from renderer.atomic import write_atomically

    if workers < 1:
        raise InputError(f"{workers} workers: give 1 or more", code="workers")
    manifest = read_manifest(out)
    _check_places(out, page)
    if train is not None:
        examples_of(train, _effects(manifest))  # which is known before anything is diagnosed
    answers = _answers(out, manifest, workers, 60.0 * minutes or math.inf, make_missing)
    if train is not None:
        answers = _classified(out, manifest, answers, train)
    result = count(answers)
    _tell_left_out(out / REPORTS_FOLDER)
    if page is not None:
        make_folder(page.absolute().parent, "name a place that can be written to")
        write_atomically(page, render_page(manifest, answers, result).encode())
    if json_output:
        values = {key: _plain(value) for key, value in asdict(result).items()}
        console.emit_json({**values, "cases": len(answers)})
        return
    console.say(f"named right {result.top1}; stage {result.stage}; alarms without cause {result.false_alarms}")


def _check_places(out: Path, page: Path | None) -> None:
    """Refuse what could not be written after the diagnoses.

    Raises:
        InputError: a place that cannot be written to.
    """
    if page is not None:
        check_file(page)
    check_folder(out, "give a folder that can be written to")


def _answers(out: Path, manifest: dict[str, Any], workers: int, seconds: float, make_missing: bool) -> list[Answer]:
    """Answers to all cases that are there, or that are made within the time, under a progress bar."""
    from diagnosis.blind.answers import answer_cases
    from diagnosis.blind.make import case_maker, plan_of

    cache = drape_cache()
    with console.progress("diagnosing", total=manifest["cases"]) as bar:
        return answer_cases(
            out,
            cache=cache,
            workers=workers,
            seconds=seconds,
            make=case_maker(out, plan_of(manifest)) if make_missing else None,
            on_case=bar.advance,
        )


def _classified(out: Path, manifest: dict[str, Any], answers: list[Answer], train: Path) -> list[Answer]:
    """The answers with those of a plain classifier that another check taught."""
    from diagnosis.blind.answers import classify

    return classify(out, train, answers, _effects(manifest))


def _effects(manifest: dict[str, Any]) -> list[str]:
    """That the diagnosis knows."""
    from diagnosis.effects import catalogue

    return [name for name in catalogue() if name not in manifest["withhold"]]


def _tell_left_out(reports: Path) -> None:
    for failed in sorted(reports.glob("*.failed")):
        console.note(f"{failed.stem} is left out: {failed.read_text(encoding='utf-8').strip()}")


def _plain(value: object) -> object:
    if isinstance(value, dict) and set(value) == {"hits", "of"}:
        return {**value, "share": value["hits"] / value["of"] if value["of"] else None}
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, float) and value != value:
        return None
    if isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    return value
