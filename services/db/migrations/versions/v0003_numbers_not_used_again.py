"""SQLite gives no number of a deleted fabric to a new one, as PostgreSQL never does: lists are paged by them."""

from __future__ import annotations

from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Forward."""
    _make_anew(never_again=True)


def downgrade() -> None:
    """Back to 0002."""
    _make_anew(never_again=False)


def _make_anew(*, never_again: bool) -> None:
    if op.get_bind().dialect.name == "sqlite":
        with op.batch_alter_table("fabrics", recreate="always", table_kwargs={"sqlite_autoincrement": never_again}):
            pass
