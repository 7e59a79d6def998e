"""`drapemeter serve`: the REST service and its job workers."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from services import console
from services.cli.options import SEED_FIXED

if TYPE_CHECKING:
    from services.settings import Settings

HELP = """Run the REST service: /v1, /healthz, /readyz, /metrics, /openapi.json.

Settings also come from the environment (DRAPEMETER_DATABASE, DRAPEMETER_MODEL, ...; see docs/api.md). On loopback
without any API key the server is open to this machine; everywhere else a key is needed ('drapemeter keys create').

\b
Example:
  drapemeter serve --port 8000 --model model/
  drapemeter serve --migrate --database postgresql://user:password@host/drapemeter
"""


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("serve", help=HELP)(serve)


def serve(
    host: str | None = typer.Option(None, help="Address to listen at; 127.0.0.1 unless set."),
    port: int | None = typer.Option(None, min=0, max=65535, help="Port; 8000 unless set, 0 for any free one."),
    database: str | None = typer.Option(None, help="sqlite:///drapemeter.db (default) or postgresql://..."),
    model: Path | None = typer.Option(None, help="Folder of the trained estimator; default: the one that ships."),
    workers: int | None = typer.Option(None, min=0, max=64, help="Job worker processes; 1 unless set."),
    ray_address: str | None = typer.Option(None, help="Ray cluster for the jobs, such as auto or ray://host:10001."),
    dataset_root: str | None = typer.Option(None, help="Folder or s3:// URL that dataset jobs write under."),
    migrate: bool = typer.Option(False, "--migrate", help="Bring the database's tables up to date and exit."),
    worker_only: bool = typer.Option(False, "--worker-only", help="Run jobs only, without the web server."),
    seed: int = SEED_FIXED,
    as_json: bool = typer.Option(False, "--json", help="One JSON document on standard output: where it listens."),
) -> None:
    given = {
        "host": host,
        "port": port,
        "database": database,
        "model": model,
        "workers": workers,
        "ray_address": ray_address,
        "dataset_root": dataset_root,
    }
    settings = load_settings(given)
    from services.logs import configure_logging

    configure_logging(settings.log_level)
    settings.require_safe()
    if migrate:
        _migrate(settings, as_json)
    elif worker_only:
        from services.jobs.processes import run_workers

        _check_cache()
        _prepare_database(settings)
        if as_json:
            console.emit_json({"workers": max(1, settings.workers)})
        run_workers(settings)
    else:
        from services.api.server import run_server

        if settings.workers:
            _check_cache()
        _prepare_database(settings)
        run_server(settings, (lambda url: console.emit_json({"url": url})) if as_json else None)


def load_settings(given: dict[str, Any]) -> Settings:
    """Settings from the environment with the options that were given.

    Raises:
        InputError: a variable that cannot be used.
    """
    from pydantic import ValidationError

    from services.settings import Settings
    from simcore.errors import InputError

    try:
        return Settings(**{name: value for name, value in given.items() if value is not None})
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        name = "_".join(str(part) for part in first["loc"]).upper()
        raise InputError(f"DRAPEMETER_{name}: {first['msg']}", code="setting_invalid") from None


def _migrate(settings: Settings, as_json: bool) -> None:
    from services.db.engine import Database
    from services.db.migrate import upgrade

    database = Database(settings.database)
    upgrade(database)
    if as_json:
        console.emit_json({"database": database.public_url, "migrated": True})
    else:
        console.say(f"{database.public_url} is up to date")
    database.close()


def _prepare_database(settings: Settings) -> None:
    """An embedded database is made as needed; a shared one is migrated on purpose only."""
    from services.db.engine import Database
    from services.db.migrate import require_current, upgrade

    database = Database(settings.database)
    if database.is_sqlite:
        upgrade(database)
    else:
        require_current(database)
    database.close()


def _check_cache() -> None:
    """Tell now what would fail every job that simulates.

    Raises:
        InputError: the folder of the caches cannot be used.
    """
    from renderer.user_cache import default_cache_folder
    from services.cli.outputs import make_folder

    place = default_cache_folder()
    if place is not None:
        make_folder(place, "set DRAPEMETER_CACHE to another folder, or to nothing at all to keep nothing between jobs")
