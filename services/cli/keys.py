"""`drapemeter keys`: API keys of the service."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from typing import TYPE_CHECKING

import typer

from services import console
from services.cli.options import JSON, SEED_FIXED, SEED_UNUSED

if TYPE_CHECKING:
    from services.db.engine import Database

HELP = """Create, list and revoke API keys of the service.

\b
Example:
  drapemeter keys create --name plm --scopes estimates:write,fabrics:read
  drapemeter keys list
  drapemeter keys revoke dm_1f2e3d4c5b6a
"""
DATABASE = typer.Option(
    None, help="Database of the service; DRAPEMETER_DATABASE or sqlite:///drapemeter.db unless set."
)


def register(app: typer.Typer) -> None:
    """Add the command and its three subcommands."""
    keys = typer.Typer(help=HELP, add_completion=False, rich_markup_mode=None)
    keys.command("create", help=CREATE_HELP)(create)
    keys.command("list", help=LIST_HELP)(list_)
    keys.command("revoke", help=REVOKE_HELP)(revoke)
    app.add_typer(keys, name="keys")


CREATE_HELP = """Make a key; it is shown once and kept only as a hash.

\b
Example:
  drapemeter keys create --name plm --scopes estimates:write,fabrics:read --expires-days 365
"""
LIST_HELP = """List keys with their scopes and last use, revoked ones too.

\b
Example:
  drapemeter keys list --json
"""
REVOKE_HELP = """Revoke a key by its identifier or prefix; it stops working at once.

\b
Example:
  drapemeter keys revoke dm_1f2e3d4c5b6a
"""


def create(
    name: str = typer.Option(..., help="Who uses the key."),
    scopes: str = typer.Option("*", help="Comma-separated permissions; * for all."),
    expires_days: float | None = typer.Option(None, help="Days until it expires; never unless set."),
    database: str | None = DATABASE,
    seed: int = SEED_FIXED,
    as_json: bool = JSON,
) -> None:
    from services.api.keys import create_key
    from services.api.scopes import parse_scopes

    wanted = parse_scopes(scopes)
    with _open(database, make=True) as opened, opened.write() as session:
        key = create_key(session, name, wanted, expires_after_days=expires_days)
    if as_json:
        expires_at = key.expires_at.isoformat() if key.expires_at else None
        console.emit_json(
            {"id": key.id, "name": key.name, "token": key.token, "scopes": key.scopes, "expires_at": expires_at}
        )
        return
    console.say(key.token)
    console.note(f"{key.name}: {', '.join(key.scopes)}. Keep the key now, it cannot be shown again.")
    console.note(f"It is one of {opened.public_url}: 'drapemeter serve' must use the same database.")


def list_(database: str | None = DATABASE, seed: int = SEED_UNUSED, as_json: bool = JSON) -> None:
    from services.api.keys import list_keys
    from services.db.base import utc_now

    with _open(database) as opened, opened.read() as session:
        keys = list_keys(session)
    if as_json:
        console.emit_json({"keys": keys})
        return
    for key in keys:
        expired = key.expires_at is not None and datetime.fromisoformat(key.expires_at) <= utc_now()
        state = "revoked" if key.revoked_at else "expired" if expired else f"last used {key.last_used_at or 'never'}"
        console.say(f"{key.prefix}  {key.name}  {state}  {','.join(key.scopes)}")


def revoke(
    key: str = typer.Argument(..., help="Identifier or prefix, from 'drapemeter keys list'."),
    database: str | None = DATABASE,
    seed: int = SEED_UNUSED,
    as_json: bool = JSON,
) -> None:
    from services.api.keys import revoke_key

    with _open(database) as opened, opened.write() as session:
        key_id = revoke_key(session, key)
    if as_json:
        console.emit_json({"id": key_id, "revoked": True})
    else:
        console.say(f"{key_id} is revoked")


@contextmanager
def _open(url: str | None, *, make: bool = False) -> Iterator[Database]:
    """The service's database; an embedded one is made where it may be."""
    from services.cli.database import open_database

    missing = "no such database, so no key: run it where 'drapemeter serve' runs, or give --database"
    with open_database(url, missing=None if make else missing) as database:
        yield database
