"""Tables of the human study of drape similarity."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from sqlalchemy import ForeignKey, LargeBinary, String, UniqueConstraint
from sqlalchemy.orm import Mapped, mapped_column
from sqlalchemy.types import JSON

from services.db.base import Base, new_id, utc_now


class Study(Base):
    """One study: a list of fabrics and how participants are asked; ``shared`` are the questions put to everybody."""

    __tablename__ = "studies"

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    id: Mapped[str] = mapped_column(String(48), unique=True, default=lambda: new_id("study"))
    name: Mapped[str] = mapped_column(String(200))
    seed: Mapped[int]
    triplets: Mapped[int]
    shared: Mapped[list[Any]] = mapped_column(JSON)
    created_at: Mapped[datetime] = mapped_column(default=utc_now)


class StudyFabric(Base):
    """A fabric of a study; ``parameters`` (SI) where they are known."""

    __tablename__ = "study_fabrics"
    __table_args__ = (UniqueConstraint("study_number", "place"),)

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    study_number: Mapped[int] = mapped_column(ForeignKey("studies.number", ondelete="CASCADE"))
    place: Mapped[int]
    name: Mapped[str] = mapped_column(String(200))
    parameters: Mapped[dict[str, Any] | None] = mapped_column(JSON(none_as_null=True))


class StudyPicture(Base):
    """A picture of a fabric; all pictures of one ``repeat`` are shown together, ordered by ``label``."""

    __tablename__ = "study_pictures"
    __table_args__ = (UniqueConstraint("fabric_number", "repeat", "label"),)

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    id: Mapped[str] = mapped_column(String(48), unique=True, default=lambda: new_id("pic"))
    fabric_number: Mapped[int] = mapped_column(ForeignKey("study_fabrics.number", ondelete="CASCADE"))
    repeat: Mapped[int]
    label: Mapped[str] = mapped_column(String(80))
    media_type: Mapped[str] = mapped_column(String(40))
    content: Mapped[bytes] = mapped_column(LargeBinary, deferred=True)


class StudyParticipant(Base):
    """Someone who answers; known by an identifier that cannot be guessed and by nothing else.

    ``questions`` holds rows of six numbers: reference, left and right fabric, and the repeat shown of each.
    """

    __tablename__ = "study_participants"
    __table_args__ = (UniqueConstraint("study_number", "place"),)

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    id: Mapped[str] = mapped_column(String(48), unique=True, default=lambda: new_id("part"))
    study_number: Mapped[int] = mapped_column(ForeignKey("studies.number", ondelete="CASCADE"))
    place: Mapped[int]
    experience: Mapped[str] = mapped_column(String(20), default="")
    simulated: Mapped[bool] = mapped_column(default=False)
    questions: Mapped[list[Any]] = mapped_column(JSON)
    created_at: Mapped[datetime] = mapped_column(default=utc_now)


class StudyAnswer(Base):
    """The fabric chosen at one position of a participant's questions; a changed mind replaces it."""

    __tablename__ = "study_answers"
    __table_args__ = (UniqueConstraint("participant_number", "position"),)

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    participant_number: Mapped[int] = mapped_column(ForeignKey("study_participants.number", ondelete="CASCADE"))
    position: Mapped[int]
    chosen: Mapped[int]
    milliseconds: Mapped[int]
    changes: Mapped[int] = mapped_column(default=0)
    answered_at: Mapped[datetime] = mapped_column(default=utc_now)
