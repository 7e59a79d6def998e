"""Studies with their fabrics, pictures, participants and answers."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

from services.db.base import UtcDateTime

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Forward."""
    _create_studies()
    _create_fabrics_and_pictures()
    _create_participants_and_answers()


def downgrade() -> None:
    """Back to 0001."""
    for table in ("study_answers", "study_participants", "study_pictures", "study_fabrics", "studies"):
        op.drop_table(table)


def _create_studies() -> None:
    op.create_table(
        "studies",
        sa.Column("number", sa.Integer(), autoincrement=True, nullable=False),
        sa.Column("id", sa.String(48), nullable=False),
        sa.Column("name", sa.String(200), nullable=False),
        sa.Column("seed", sa.Integer(), nullable=False),
        sa.Column("triplets", sa.Integer(), nullable=False),
        sa.Column("shared", sa.JSON(), nullable=False),
        sa.Column("created_at", UtcDateTime(), nullable=False),
        sa.PrimaryKeyConstraint("number", name=op.f("pk_studies")),
        sa.UniqueConstraint("id", name=op.f("uq_studies_id")),
    )


def _create_fabrics_and_pictures() -> None:
    op.create_table(
        "study_fabrics",
        sa.Column("number", sa.Integer(), autoincrement=True, nullable=False),
        sa.Column("study_number", sa.Integer(), nullable=False),
        sa.Column("place", sa.Integer(), nullable=False),
        sa.Column("name", sa.String(200), nullable=False),
        sa.Column("parameters", sa.JSON(none_as_null=True), nullable=True),
        sa.ForeignKeyConstraint(
            ["study_number"],
            ["studies.number"],
            name=op.f("fk_study_fabrics_study_number_studies"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("number", name=op.f("pk_study_fabrics")),
        sa.UniqueConstraint("study_number", "place", name=op.f("uq_study_fabrics_study_number")),
    )
    op.create_table(
        "study_pictures",
        sa.Column("number", sa.Integer(), autoincrement=True, nullable=False),
        sa.Column("id", sa.String(48), nullable=False),
        sa.Column("fabric_number", sa.Integer(), nullable=False),
        sa.Column("repeat", sa.Integer(), nullable=False),
        sa.Column("label", sa.String(80), nullable=False),
        sa.Column("media_type", sa.String(40), nullable=False),
        sa.Column("content", sa.LargeBinary(), nullable=False),
        sa.ForeignKeyConstraint(
            ["fabric_number"],
            ["study_fabrics.number"],
            name=op.f("fk_study_pictures_fabric_number_study_fabrics"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("number", name=op.f("pk_study_pictures")),
        sa.UniqueConstraint("fabric_number", "repeat", "label", name=op.f("uq_study_pictures_fabric_number")),
        sa.UniqueConstraint("id", name=op.f("uq_study_pictures_id")),
    )


def _create_participants_and_answers() -> None:
    op.create_table(
        "study_participants",
        sa.Column("number", sa.Integer(), autoincrement=True, nullable=False),
        sa.Column("id", sa.String(48), nullable=False),
        sa.Column("study_number", sa.Integer(), nullable=False),
        sa.Column("place", sa.Integer(), nullable=False),
        sa.Column("experience", sa.String(20), nullable=False),
        sa.Column("simulated", sa.Boolean(), nullable=False),
        sa.Column("questions", sa.JSON(), nullable=False),
        sa.Column("created_at", UtcDateTime(), nullable=False),
        sa.ForeignKeyConstraint(
            ["study_number"],
            ["studies.number"],
            name=op.f("fk_study_participants_study_number_studies"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("number", name=op.f("pk_study_participants")),
        sa.UniqueConstraint("id", name=op.f("uq_study_participants_id")),
        sa.UniqueConstraint("study_number", "place", name=op.f("uq_study_participants_study_number")),
    )
    op.create_table(
        "study_answers",
        sa.Column("number", sa.Integer(), autoincrement=True, nullable=False),
        sa.Column("participant_number", sa.Integer(), nullable=False),
        sa.Column("position", sa.Integer(), nullable=False),
        sa.Column("chosen", sa.Integer(), nullable=False),
        sa.Column("milliseconds", sa.Integer(), nullable=False),
        sa.Column("changes", sa.Integer(), nullable=False),
        sa.Column("answered_at", UtcDateTime(), nullable=False),
        sa.ForeignKeyConstraint(
            ["participant_number"],
            ["study_participants.number"],
            name=op.f("fk_study_answers_participant_number_study_participants"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("number", name=op.f("pk_study_answers")),
        sa.UniqueConstraint("participant_number", "position", name=op.f("uq_study_answers_participant_number")),
    )
