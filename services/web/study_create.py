"""Putting a human study into the database, and listing those that are there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from sqlalchemy import func, select
from sqlalchemy.orm import Session

from metric.triplets import check_plan, shared_triplets
from services.db.engine import Database
from services.db.studies import Study, StudyAnswer, StudyFabric, StudyParticipant, StudyPicture
from services.web.study_store import StudyStore
from simcore.errors import InputError
from simcore.parameters import FabricParameters

MOST_NAME = 200
"""Characters of a name in the database."""


@dataclass(frozen=True)
class PictureFile:
    """A picture to show: all of one ``repeat`` together, in the order of ``label``."""

    repeat: int
    label: str
    media_type: str
    content: bytes


@dataclass(frozen=True)
class StudyEntry:
    """A fabric to put into a study."""

    name: str
    parameters: FabricParameters | None
    pictures: tuple[PictureFile, ...]


def check_names(study: str, fabrics: Sequence[str]) -> None:
    """Refuse names that a study cannot have, before its pictures are made.

    Raises:
        InputError: one is empty, too long, holds a NUL or is no text, or two fabrics have the same.
    """
    if len(set(fabrics)) != len(fabrics) or not all(fabrics):
        raise InputError("every fabric of a study needs a name of its own", code="study_names")
    for name in (study, *fabrics):
        if any("\ud800" <= letter <= "\udfff" for letter in name):
            shown = name.encode(errors="backslashreplace").decode()
            raise InputError(f"{shown[:40]!r}: a name must be text in UTF-8; rename it", code="study_names")
        if not 0 < len(name) <= MOST_NAME or "\0" in name:
            raise InputError(
                f"{name[:40]!r}: the name of a study or a fabric has 1 to {MOST_NAME} characters, none of them NUL",
                code="study_names",
            )


def create_study(
    database: Database, name: str, entries: Sequence[StudyEntry], *, triplets: int, shared: int, seed: int
) -> StudyStore:
    """Put a study into the database.

    Args:
        database: with its tables up to date.
        name: for people.
        entries: its fabrics with their pictures.
        triplets: questions a participant.
        shared: of these, questions put to everybody.
        seed: of everything drawn at random.

    Raises:
        InputError: too few or nameless fabrics, no pictures, or numbers that do not fit together.
    """
    check_names(name, [entry.name for entry in entries])
    check_plan(len(entries), triplets)
    if not 0 <= shared <= triplets:
        raise InputError(f"shared triplets must be from 0 to {triplets}, got {shared}", code="triplets_shared")
    if not 0 <= seed < 2**31:
        raise InputError(f"the seed must be from 0 to 2147483647, got {seed}", code="seed_out_of_range")
    bare = [entry.name for entry in entries if not entry.pictures]
    if bare:
        raise InputError(f"no pictures of {', '.join(bare)}", code="study_pictures_missing")
    questions = shared_triplets(len(entries), np.random.default_rng((seed, 0)), shared)
    with database.write() as session:
        study = Study(
            name=name,
            seed=seed,
            triplets=triplets,
            shared=[[t.reference, t.left, t.right] for t in questions],
        )
        session.add(study)
        session.flush()
        for place, entry in enumerate(entries):
            _add_fabric(session, study, place, entry)
    return StudyStore(database, study.id)


def list_studies(database: Database) -> list[dict[str, Any]]:
    """Every study with the number of its fabrics, of people who began and of those who answered, and of answers, oldest
    first."""
    with database.read() as session:
        return [_summary(session, study) for study in session.scalars(select(Study).order_by(Study.number))]


def _summary(session: Session, study: Study) -> dict[str, Any]:
    def count(simulated: bool) -> tuple[int, int, int]:
        people = (StudyParticipant.study_number == study.number, StudyParticipant.simulated.is_(simulated))
        begun = session.scalar(select(func.count()).select_from(StudyParticipant).where(*people)) or 0
        participants, answers = session.execute(
            select(func.count(StudyAnswer.participant_number.distinct()), func.count())
            .select_from(StudyAnswer)
            .join(StudyParticipant, StudyParticipant.number == StudyAnswer.participant_number)
            .where(*people)
        ).one()
        return begun, participants, answers

    fabrics = session.scalar(
        select(func.count()).select_from(StudyFabric).where(StudyFabric.study_number == study.number)
    )
    (begun, people, answers), (_, observers, simulated_answers) = count(False), count(True)
    return {
        "id": study.id,
        "name": study.name,
        "fabrics": fabrics,
        "triplets": study.triplets,
        "begun": begun,
        "participants": people,
        "answers": answers,
        "simulated_observers": observers,
        "simulated_answers": simulated_answers,
        "created_at": study.created_at.isoformat(),
    }


def _add_fabric(session: Session, study: Study, place: int, entry: StudyEntry) -> None:
    parameters = None if entry.parameters is None else entry.parameters.as_dict()
    fabric = StudyFabric(study_number=study.number, place=place, name=entry.name, parameters=parameters)
    session.add(fabric)
    session.flush()
    session.add_all(
        StudyPicture(
            fabric_number=fabric.number,
            repeat=picture.repeat,
            label=picture.label,
            media_type=picture.media_type,
            content=picture.content,
        )
        for picture in entry.pictures
    )
