"""Regular expressions of what texts may hold; PostgreSQL takes no NUL."""

from __future__ import annotations

NO_NUL = r"^[^\x00]*$"
PRINTABLE = r"^[\x21-\x7e]+$"
"""Identifiers."""
