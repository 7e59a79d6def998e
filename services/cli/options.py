"""Options that every command has."""

from __future__ import annotations

import typer

JSON = typer.Option(False, "--json", help="One JSON document on standard output.")

SEED_UNUSED = typer.Option(0, "--seed", min=0, help="Accepted by every command; nothing in this one is random.")

SEED_FIXED = typer.Option(
    0, "--seed", min=0, help="Accepted by every command; the result of this one does not depend on it."
)
"""Where something is drawn at random all the same: under a seed of its own, or, as a key must be, under none."""
