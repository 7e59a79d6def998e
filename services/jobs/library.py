"""The fabric library as a search job needs it."""

from __future__ import annotations

from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.db.fabrics import Fabric


def load_library(session: Session) -> list[dict[str, Any]]:
    """Identifier, name, parameters and ``plm_ref`` (None: it has none) of every fabric, oldest first."""
    rows = session.scalars(select(Fabric).order_by(Fabric.number))
    return [{"id": r.id, "name": r.name, "parameters": r.parameters, "plm_ref": r.plm_ref} for r in rows]
