"""`drapemeter dataset`: sweep fabrics, scenes and repeats into a store, and look after stores."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from services import console
from services.cli.dataset_run import Placement, say_cost, sweep
from services.cli.options import JSON, SEED_UNUSED
from services.dataset.solver_kind import SolverKind
from services.names import split_names
from simcore.errors import InputError

if TYPE_CHECKING:
    from services.dataset.configuration import SweepConfiguration

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
        None,
        "--address",
        help="Running Ray cluster (auto, host:port, ray://host:port); default: RAY_ADDRESS, else a local one.",
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
        scenes=split_names(scenes),
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
