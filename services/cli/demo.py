"""`drapemeter demo`: the whole chain, small, into one folder."""

from __future__ import annotations

from pathlib import Path

import typer

from services import console
from services.cli.options import JSON
from simcore.errors import InputError


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("demo")(demo)


def demo(
    out: Path = typer.Option(
        Path("demo-out"), "--out", help="Folder for everything; an earlier demo there is replaced."
    ),
    seed: int = typer.Option(0, "--seed", help="Of everything random."),
    json_output: bool = JSON,
) -> None:
    """Run the whole chain, small, on embedded defaults: simulate, render, store, train, estimate, compare, diagnose.

    Takes some minutes on two cores and needs neither a camera nor a network. Open index.html in the folder at the end.
    Drape distances are LPIPS's where its weights are found (DRAPEMETER_WEIGHTS, or a download); else depth stands in
    and the page says so.

    \b
    Example:
      drapemeter demo --out demo-out
    """
    if seed < 0:
        raise InputError(f"seed {seed} is negative: give 0 or more", code="seed_negative")
    from services.demo.chain import run_chain
    from services.demo.page import write_page
    from services.demo.plan import DemoPlan
    from services.demo.report import as_document, print_summary, write_document

    plan = DemoPlan(seed=seed)
    result = run_chain(out, plan)
    page = write_page(out, result, plan)
    write_document(out, result)
    if json_output:
        console.emit_json(as_document(out, result))
    else:
        print_summary(result, page)
