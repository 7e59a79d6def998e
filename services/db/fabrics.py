"""Table of the fabric library."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from sqlalchemy import String, UniqueConstraint
from sqlalchemy.orm import Mapped, mapped_column

from services.db.base import Base, new_id, utc_now


class Fabric(Base):
    """A fabric with its seven parameters (SI) and where it comes from in a product-lifecycle system."""

    __tablename__ = "fabrics"
    __table_args__ = (UniqueConstraint("plm_system", "plm_id", "plm_revision"), {"sqlite_autoincrement": True})

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    id: Mapped[str] = mapped_column(String(48), unique=True, default=lambda: new_id("fab"))
    name: Mapped[str] = mapped_column(String(200))
    parameters: Mapped[dict[str, Any]]
    plm_system: Mapped[str | None] = mapped_column(String(80))
    plm_id: Mapped[str | None] = mapped_column(String(200))
    plm_revision: Mapped[str | None] = mapped_column(String(80))
    attributes: Mapped[dict[str, Any]] = mapped_column(default=dict)
    model_version: Mapped[str | None] = mapped_column(String(120))
    version: Mapped[int] = mapped_column(default=1)
    created_at: Mapped[datetime] = mapped_column(default=utc_now)
    updated_at: Mapped[datetime] = mapped_column(default=utc_now)

    @property
    def plm_ref(self) -> dict[str, str] | None:
        """System, id and revision there; None: no such system knows it."""
        if self.plm_system is None or self.plm_id is None or self.plm_revision is None:
            return None
        return {"system": self.plm_system, "id": self.plm_id, "revision": self.plm_revision}
