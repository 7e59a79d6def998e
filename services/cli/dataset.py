"""`drapemeter dataset`: sweep fabrics, scenes and repeats into a store, and look after stores."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from services.cli import console
from services.cli.options import JSON, SEED_UNUSED
from services.dataset.solver_kind import SolverKind
from simcore.errors import InputError, StoreError

if TYPE_CHECKING:
    from services.dataset.configuration import SweepConfiguration
    from services.dataset.cost import CostEstimate
    from services.dataset.fabrics import FabricTable
    from services.dataset.worker import SimulationDone

NOTE_S = 60.0
"""Seconds between two lines of progress where there is no terminal."""

STORE_ARGUMENT = typer.Argument(help="Local folder, s3://bucket/prefix or any URL that obstore takes.")


def register(app: typer.Typer) -> None:
    """Add the command and its subcommands."""
    group = typer.Typer(rich_markup_mode=None, context_settings={"help_option_names": ["-h", "--help"]})
    group.callback(invoke_without_command=True)(dataset)
    group.command("inspect")(inspect)
    group.command("validate")(validate)
    group.command("merge")(merge)
    group.command("export")(export)
    app.add_typer(group, name="dataset")


def dataset(
    context: typer.Context,
    materials: int | None = typer.Option(None, "--materials", min=1, help="Number of fabrics."),
    jitters: int = typer.Option(2, "--jitters", min=1, help="Repeats of each fabric and scene."),
    out: str | None = typer.Option(None, "--out", help="Store: local folder, s3://... or any URL of obstore."),
    resolution: float = typer.Option(0.01, "--resolution", help="Edge of a mesh cell [m]; must divide 0.5 m."),
    scenes: str = typer.Option("hanging,stretch", "--scenes", help="Scenes, separated by commas."),
    inclinations: int = typer.Option(11, "--inclinations", help="Pictures of each drape, over ±5 degrees."),
    seed: int = typer.Option(0, "--seed", help="Of everything random: the same seed gives the same store."),
    design: str = typer.Option("sobol", "--design", help="sobol, random, grid or list."),
    fabrics: Path | None = typer.Option(None, "--fabrics", help="CSV or JSON file of fabrics (design list)."),
    ranges: list[str] = typer.Option([], "--range", help="NAME=LOW:HIGH, SI; may be repeated."),
    time_limit: float = typer.Option(120.0, "--time-limit", help="CPU seconds a simulation may take."),
    shard_simulations: int = typer.Option(0, "--shard-simulations", help="Simulations of a shard; 0: by size."),
    address: str | None = typer.Option(
        None, "--address", help="Running Ray cluster (auto, host:port, ray://host:port); else a local one."
    ),
    workers: int | None = typer.Option(None, "--workers", min=1, help="Worker processes; default: all CPUs."),
    recycle: int = typer.Option(2000, "--recycle", min=1, help="Simulations after which a worker is replaced."),
    sensor: str = typer.Option("ideal", "--sensor", help="ideal, or sr300: what the depth camera adds."),
    simulator: Path | None = typer.Option(
        None, "--simulator", help="simulator.json of `drapemeter diagnose --apply`: sweep with the effects found."
    ),
    solver: SolverKind = typer.Option(
        SolverKind.SINGLE, "--solver", help="One drape after the other, or a shard at once on the CPU or on GPUs."
    ),
    resume: bool = typer.Option(False, "--resume", help="Finish a store that was interrupted."),
    dry_run: bool = typer.Option(False, "--dry-run", help="Only say what the sweep would cost."),
    json_output: bool = JSON,
) -> None:
    """Sweep fabrics, scenes and repeats into a store of depth pictures, on Ray.

    Fabrics are drawn from the distribution of measured ones (scrambled Sobol) unless --design or --fabrics says
    otherwise. A failed simulation is a row with a status and a reason. An interrupted sweep is finished by the same
    command with --resume and gives the same store, bit for bit.

    \b
    Example:
      drapemeter dataset --materials 200 --jitters 2 --out store.zarr
      drapemeter dataset --materials 200 --simulator report/simulator.json --out extended.zarr
      drapemeter dataset inspect store.zarr --figures out/
    """
    if context.invoked_subcommand is not None:
        _refuse_options(context)
        return
    from services.dataset.fabrics import plan_sweep

    configuration, table = plan_sweep(
        design=design,
        fabrics=fabrics,
        materials=materials,
        jitters=jitters,
        scenes=tuple(name.strip() for name in scenes.split(",") if name.strip()),
        inclinations=inclinations,
        resolution_m=resolution,
        seed=seed,
        ranges=parse_ranges(ranges),
        time_limit_s=time_limit,
        simulations_per_shard=shard_simulations,
        sensor=sensor,
        simulator=simulator or (),
        solver=solver,
    )
    if simulator is not None:
        console.note(describe_simulator(configuration))
    if dry_run:
        say_cost(configuration, workers, json_output)
        return
    if out is None:
        raise InputError("say where the store shall be: --out store.zarr", code="out_missing")
    placement = Placement(address, workers, recycle)
    sweep(out, configuration, table, placement, resume=resume, json_output=json_output)


def _refuse_options(context: typer.Context) -> None:
    """Options that stand before a subcommand would be passed over.

    Raises:
        InputError: there are some.
    """
    for option in context.command.params:
        source = context.get_parameter_source(option.name or "")
        if source is not None and source.name == "COMMANDLINE":
            raise InputError(
                f"{option.opts[0]} stands before {context.invoked_subcommand}: options of "
                f"`drapemeter dataset {context.invoked_subcommand}` go behind it",
                code="options_exclude",
            )


def describe_simulator(configuration: SweepConfiguration) -> str:
    """One line for people."""
    effects = " ".join(f"--effect {effect.option}" for effect in configuration.simulator)
    held = "" if configuration.pin_radius_m is None else f"--pin-radius {configuration.pin_radius_m:g}"
    found = " ".join(part for part in (effects, held) if part)
    return f"simulated with {found}" if found else "the simulator file names no effect: the plain simulator"


def parse_ranges(texts: list[str]) -> dict[str, tuple[float, float]]:
    """``NAME=LOW:HIGH`` to numbers.

    Raises:
        InputError: another form.
    """
    ranges = {}
    for text in texts:
        name, _, pair = text.partition("=")
        low, _, high = pair.partition(":")
        if name.strip() in ranges:
            raise InputError(f"--range {name.strip()} is given twice: give it once", code="range_form")
        try:
            ranges[name.strip()] = (float(low), float(high))
        except ValueError:
            raise InputError(
                f"--range {text!r}: write NAME=LOW:HIGH, for example density=0.1:0.3", code="range_form"
            ) from None
    return ranges


@dataclass(frozen=True)
class Placement:
    """Where and on how many processes a sweep runs; no bit of the store depends on it."""

    address: str | None
    workers: int | None
    recycle_after: int


def say_cost(configuration: SweepConfiguration, workers: int | None, json_output: bool) -> None:
    """Print what a sweep would cost."""
    from services.dataset.cost import estimate_cost

    cost = estimate_cost(configuration, workers or os.cpu_count() or 1)
    if json_output:
        console.emit_json(cost)
    else:
        console.say(describe_cost(cost))


def describe_cost(cost: CostEstimate) -> str:
    """One line for people."""
    return (
        f"{cost.simulations} simulations, {cost.pictures} pictures: about {cost.core_hours:.2g} core hours, "
        f"{cost.hours:.2g} h on {cost.workers} workers, {cost.gigabytes:.2g} GB{f' ({cost.note})' if cost.note else ''}"
    )


class Watch:
    """Follows a sweep: a bar on a terminal, elsewhere (a cluster's log) a line a minute.

    Args:
        bar: the bar, a no-op where there is no terminal.
    """

    def __init__(self, bar: console.ProgressBar) -> None:
        self._bar = bar
        self._total = self._done = self._failed = 0
        self._first = self._noted = 0.0

    def begin(self, cost: CostEstimate) -> None:
        """The sweep starts."""
        if (
            threading.current_thread() is threading.main_thread()
        ):  # a scheduler ends a job so; Ray has set its own by now
            signal.signal(signal.SIGTERM, signal.default_int_handler)
        console.note(describe_cost(cost))
        self._bar.update(total=cost.simulations)
        self._total, self._noted = cost.simulations, time.monotonic()

    def hear(self, word: SimulationDone) -> None:
        """A simulation is done."""
        now = time.monotonic()
        self._first = self._first or now
        self._done += 1
        self._failed += word.status.label != "ok"
        self._bar.advance()
        if now - self._noted >= NOTE_S and not sys.stderr.isatty():
            self._noted = now
            left = (now - self._first) / self._done * (self._total - self._done)
            console.note(f"{self._done} of {self._total} simulations, {self._failed} failed, {left / 60:.0f} min to go")


def sweep(
    out: str,
    configuration: SweepConfiguration,
    table: FabricTable,
    placement: Placement,
    *,
    resume: bool,
    json_output: bool,
) -> None:
    """Run the sweep under a progress bar and print its summary."""
    from services.dataset.sweep import run_sweep

    with console.progress("simulations", total=configuration.layout.simulations) as bar:
        watch = Watch(bar)
        try:
            summary = run_sweep(
                out,
                configuration,
                table,
                resume=resume,
                address=placement.address,
                workers=placement.workers,
                recycle_after=placement.recycle_after,
                listen=watch.hear,
                begin=watch.begin,
            )
        except KeyboardInterrupt:
            console.note(f"{out}: what is done is kept; the same command with --resume goes on")
            raise
        except StoreError as error:
            raise StoreError(f"{error}; what is done is kept, --resume does the rest", code=error.code) from error
    if json_output:
        console.emit_json(summary)
        return
    failed = sum(summary.failed.values())
    reasons = ", ".join(f"{name} {count}" for name, count in summary.failed.items())
    console.say(f"{summary.samples} samples in {out}, {failed} failed{f' ({reasons})' if failed else ''}")


def inspect(
    store: str = STORE_ARGUMENT,
    figures: Path | None = typer.Option(None, "--figures", help="Folder for a contact sheet and the Spearman matrix."),
    seed: int = SEED_UNUSED,
    json_output: bool = JSON,
) -> None:
    """Counts, failures by reason and ranges of a store; pictures of it on request.

    \b
    Example:
      drapemeter dataset inspect store.zarr --figures out/
    """
    from renderer.store import Store
    from services.cli.outputs import check_folder
    from services.dataset.inspection import inspect_store

    if figures is not None:
        check_folder(figures, "name a folder that can be written to")
    opened = Store.open(store)
    report = inspect_store(opened)
    if figures is not None:
        from services.dataset.figures import write_figures

        for path in write_figures(opened, figures):
            console.note(f"wrote {path}")
    if json_output:
        console.emit_json(report)
        return
    console.say(f"{report.samples} samples of {report.materials} fabrics, scenes {', '.join(report.scenes)}")
    console.say(
        f"shards: {report.shards_complete} of {report.shards} complete; {report.stored_bytes / 1e6:.1f} MB stored"
    )
    console.say(f"ok {report.ok}; failed {report.failed or 'none'}")
    for name, (low, high) in report.ranges.items():
        console.say(f"  {name:14s} {low:.4g} to {high:.4g}")


def validate(store: str = STORE_ARGUMENT, seed: int = SEED_UNUSED, json_output: bool = JSON) -> None:
    """Check schema, checksums and that every sample is there exactly once; exits 1 when something is wrong.

    \b
    Example:
      drapemeter dataset validate store.zarr
    """
    from renderer.store import Store
    from services.dataset.validation import validate_store

    opened = Store.open(store)
    with console.progress("shards", total=opened.shards) as bar:
        report = validate_store(opened, listen=lambda shard: bar.advance())
    if json_output:
        console.emit_json(report)
    else:
        console.say(f"{report.samples} samples in {report.shards} shards: {'valid' if report.valid else 'NOT valid'}")
        for fault in report.faults:
            console.say(f"  {fault}")
    if not report.valid:
        raise typer.Exit(1)


def merge(
    stores: list[str] = typer.Argument(help="Two or more complete stores."),
    out: str = typer.Option(..., "--out", help="The new store."),
    seed: int = SEED_UNUSED,
    json_output: bool = JSON,
) -> None:
    """Join stores with the same scenes, repeats, inclinations and mesh into one.

    \b
    Example:
      drapemeter dataset merge one.zarr two.zarr --out both.zarr
    """
    from renderer.store import Store
    from services.dataset.merge import merge_stores
    from services.dataset.sweep import count_failures

    sources = [Store.open(store) for store in stores]
    with console.progress("shards") as bar:
        merged = merge_stores(sources, out, listen=lambda shard: bar.advance())
    if json_output:
        console.emit_json(
            {"samples": len(merged), "failed": count_failures(merged), "materials": merged.layout.materials}
        )
        return
    console.say(f"{len(merged)} samples of {merged.layout.materials} fabrics in {out}")


def export(
    store: str = STORE_ARGUMENT,
    out: Path = typer.Option(..., "--out", help="New folder for samples.csv and the pictures."),
    shaded: bool = typer.Option(False, "--shaded", help="Also draw the drapes as white cloth on black."),
    limit: int | None = typer.Option(None, "--limit", min=1, help="Only the first so many samples."),
    seed: int = SEED_UNUSED,
    json_output: bool = JSON,
) -> None:
    """Write a store as 16-bit PNG depth pictures and a CSV table.

    \b
    Example:
      drapemeter dataset export store.zarr --out pictures/ --shaded --limit 100
    """
    from renderer.store import Store
    from services.dataset.export import export_store

    opened = Store.open(store)
    with console.progress("shards", total=opened.shards) as bar:
        count = export_store(opened, out, shaded=shaded, limit=limit, listen=lambda shard: bar.advance())
    if json_output:
        console.emit_json({"samples": count, "folder": out})
        return
    console.say(f"{count} samples in {out}")
