"""The fabric library as a search job needs it."""

from __future__ import annotations

from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.db.fabrics import Fabric


def load_library(session: Session) -> list[dict[str, Any]]:
    """Identifier, name and parameters of every fabric, oldest first."""
    rows = session.execute(select(Fabric.id, Fabric.name, Fabric.parameters).order_by(Fabric.number))
    return [{"id": row.id, "name": row.name, "parameters": row.parameters} for row in rows]
