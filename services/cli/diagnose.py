"""`drapemeter diagnose`: where simulation and captures part, and why."""

from __future__ import annotations

import json
from pathlib import Path

import typer

from services.cli import console
from simcore.errors import InputError


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("diagnose")(diagnose)


def diagnose(
    capture_set: Path = typer.Argument(..., help="Capture set: a folder with captures.json."),
    out: Path = typer.Option(..., "--out", help="Folder for report.json and report.html; made if absent."),
    effects: str = typer.Option("", "--effects", help="Try only these, comma-separated; default: the catalogue."),
    without: str = typer.Option("", "--without", help="Leave these effects out, comma-separated."),
    resolution: float = typer.Option(0.01, "--resolution", help="Edge of a mesh cell [m]."),
    workers: int = typer.Option(1, "--workers", help="Processes; each takes a fabric at a time."),
    json_output: bool = typer.Option(False, "--json", help="One JSON document on standard output."),
) -> None:
    """Compare captures with simulations of the same fabrics; name the effect that the simulation lacks.

    Writes report.json (format drape-gap-report/1) and report.html, one page with pictures. The simulations are kept in
    the cache folder (DRAPEMETER_CACHE), so a second run is short.

    \b
    Example:
      drapemeter diagnose my-captures --out report/ --workers 2
    """
    from capture.capture_set import CaptureSet
    from diagnosis.diagnose import DiagnosisOptions
    from diagnosis.diagnose import diagnose as run

    if out.exists() and not out.is_dir():
        raise InputError(f"{out} is a file: give a folder for the report", code="output_is_file")
    options = DiagnosisOptions(_names(effects), _names(without), resolution, workers)
    options.chosen()
    captures = CaptureSet.load(capture_set)
    shown = {capture.fabric.id for capture in captures.captures}
    with console.progress("simulating", total=len(shown)) as bar:
        found = run(captures, options, on_fabric=bar.advance)
    from diagnosis.html import render_html, sentence
    from renderer.atomic import write_atomically

    out.mkdir(parents=True, exist_ok=True)
    page = render_html(found, captures.document.name or capture_set.name)
    write_atomically(out / "report.html", page.encode())
    document = found.report.as_json()
    write_atomically(out / "report.json", (json.dumps(document, indent=1) + "\n").encode())
    if json_output:
        console.emit_json(document)
        return
    console.say(sentence(found))
    for name, p in sorted(found.report.cause.probabilities.items(), key=lambda item: -item[1])[:5]:
        console.say(f"  {name:20s} {p:.3f}")
    console.say(f"{out / 'report.json'}, {out / 'report.html'}")


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())
