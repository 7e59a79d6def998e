"""Reading and writing a human study in the database."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

import numpy as np
from sqlalchemy import func, select
from sqlalchemy.orm import Session

from metric.triplets import Answer, Triplet, draw_triplets
from services.db.base import utc_now
from services.db.engine import Database
from services.db.studies import Study, StudyAnswer, StudyFabric, StudyParticipant, StudyPicture
from services.names import is_text
from simcore.errors import InputError

EXPERIENCES = ("", "none", "some", "professional")


@dataclass(frozen=True)
class ExportedAnswer:
    """One raw answer with all that was known when it was given; ``participant`` is a number within the study, not the
    identifier with which answers may be changed.
    """

    participant: int
    simulated: bool
    experience: str
    position: int
    reference: str
    left: str
    right: str
    chosen: str
    reference_repeat: int
    left_repeat: int
    right_repeat: int
    milliseconds: int
    changes: int
    answered_at: datetime


class StudyStore:
    """One study in a database whose tables are up to date.

    Args:
        database: the database.
        study_id: identifier of the study.

    Raises:
        InputError: no such study.
    """

    def __init__(self, database: Database, study_id: str) -> None:
        self.database = database
        with database.read() as session:
            self.study = find_study(session, study_id)
            self.fabrics = list(
                session.scalars(
                    select(StudyFabric).where(StudyFabric.study_number == self.study.number).order_by(StudyFabric.place)
                )
            )
            rows = session.execute(
                select(StudyPicture.fabric_number, StudyPicture.repeat, StudyPicture.id)
                .where(StudyPicture.fabric_number.in_([f.number for f in self.fabrics]))
                .order_by(StudyPicture.fabric_number, StudyPicture.repeat, StudyPicture.label)
            ).all()
        places = {f.number: f.place for f in self.fabrics}
        self._pictures: dict[tuple[int, int], list[str]] = {}
        for number, repeat, picture_id in rows:
            self._pictures.setdefault((places[number], repeat), []).append(picture_id)

    def pictures(self, place: int, repeat: int) -> list[str]:
        """Identifiers of a fabric's pictures of one repeat, in order."""
        return self._pictures[place, repeat]

    def first_pictures(self, place: int) -> list[str]:
        """The same of a fabric's first repeat."""
        return self.pictures(place, min(r for p, r in self._pictures if p == place))

    def picture(self, picture_id: str) -> tuple[str, bytes] | None:
        """Media type and content of a picture of this study."""
        with self.database.read() as session:
            row = session.execute(
                select(StudyPicture.media_type, StudyPicture.content)
                .join(StudyFabric, StudyFabric.number == StudyPicture.fabric_number)
                .where(StudyPicture.id == picture_id, StudyFabric.study_number == self.study.number)
            ).one_or_none()
        return None if row is None else (row.media_type, row.content)

    def add_participant(self, *, experience: str = "", simulated: bool = False) -> StudyParticipant:
        """A new participant with questions of their own.

        Raises:
            InputError: unknown experience.
        """
        if experience not in EXPERIENCES:
            raise InputError(f"experience must be one of {', '.join(EXPERIENCES[1:])}", code="experience_unknown")
        with self.database.write() as session:
            _lock(session, Study, self.study.number)
            place = (
                session.scalar(
                    select(func.count())
                    .select_from(StudyParticipant)
                    .where(StudyParticipant.study_number == self.study.number)
                )
                or 0
            )
            participant = StudyParticipant(
                study_number=self.study.number,
                place=place,
                experience=experience,
                simulated=simulated,
                questions=self._questions(place),
            )
            session.add(participant)
        return participant

    def participant(self, participant_id: str) -> StudyParticipant | None:
        """A participant of this study."""
        with self.database.read() as session:
            return session.scalar(
                select(StudyParticipant).where(
                    StudyParticipant.id == participant_id, StudyParticipant.study_number == self.study.number
                )
            )

    def chosen(self, participant: StudyParticipant) -> dict[int, int]:
        """Position to chosen fabric, of the questions answered so far."""
        with self.database.read() as session:
            rows = session.execute(
                select(StudyAnswer.position, StudyAnswer.chosen).where(
                    StudyAnswer.participant_number == participant.number
                )
            )
            return {row.position: row.chosen for row in rows}

    def answer(self, participant: StudyParticipant, position: int, chosen: int, milliseconds: int) -> None:
        """Record an answer; another one given before to the same question is replaced and counted as a change, the same
        one stands with the time that it took.

        Raises:
            InputError: no such question, or a fabric that it does not offer.
        """
        if not 0 <= position < len(participant.questions):
            raise InputError(f"there is no question {position}", code="question_unknown")
        _, left, right, *_ = participant.questions[position]
        if chosen not in (left, right):
            raise InputError(f"question {position} does not offer fabric {chosen}", code="answer_not_offered")
        with self.database.write() as session:
            _lock(session, StudyParticipant, participant.number)
            row = session.scalar(
                select(StudyAnswer).where(
                    StudyAnswer.participant_number == participant.number, StudyAnswer.position == position
                )
            )
            if row is None:
                session.add(
                    StudyAnswer(
                        participant_number=participant.number,
                        position=position,
                        chosen=chosen,
                        milliseconds=milliseconds,
                    )
                )
                return
            if row.chosen != chosen:
                row.changes += 1
                row.chosen, row.milliseconds, row.answered_at = chosen, milliseconds, utc_now()

    def answers(self, *, simulated: bool) -> list[Answer]:
        """All answers of people, or all of simulated observers; never mixed."""
        return [
            Answer(e.participant.id, Triplet(*e.participant.questions[e.row.position][:3]), e.row.chosen, simulated)
            for e in self._answer_rows()
            if e.participant.simulated is simulated
        ]

    def export(self) -> list[ExportedAnswer]:
        """Every raw answer, by participant and position."""
        return [self._exported(e) for e in self._answer_rows()]

    def _questions(self, place: int) -> list[list[int]]:
        rng = np.random.default_rng((self.study.seed, 1, place))
        shared = [Triplet(*row) for row in self.study.shared]
        repeats = {f.place: sorted(r for p, r in self._pictures if p == f.place) for f in self.fabrics}
        return [
            [t.reference, t.left, t.right, *(int(rng.choice(repeats[f])) for f in (t.reference, t.left, t.right))]
            for t in draw_triplets(len(self.fabrics), rng, count=self.study.triplets, shared=shared)
        ]

    def _answer_rows(self) -> list[_Row]:
        with self.database.read() as session:
            rows = session.execute(
                select(StudyParticipant, StudyAnswer)
                .join(StudyAnswer, StudyAnswer.participant_number == StudyParticipant.number)
                .where(StudyParticipant.study_number == self.study.number)
                .order_by(StudyParticipant.place, StudyAnswer.position)
            ).all()
        return [_Row(participant, answer) for participant, answer in rows]

    def _exported(self, entry: _Row) -> ExportedAnswer:
        reference, left, right, *repeats = entry.participant.questions[entry.row.position]
        names = [f.name for f in self.fabrics]
        return ExportedAnswer(
            participant=entry.participant.place,
            simulated=entry.participant.simulated,
            experience=entry.participant.experience,
            position=entry.row.position,
            reference=names[reference],
            left=names[left],
            right=names[right],
            chosen=names[entry.row.chosen],
            reference_repeat=repeats[0],
            left_repeat=repeats[1],
            right_repeat=repeats[2],
            milliseconds=entry.row.milliseconds,
            changes=entry.row.changes,
            answered_at=entry.row.answered_at,
        )


@dataclass(frozen=True)
class _Row:
    participant: StudyParticipant
    row: StudyAnswer


def find_study(session: Session, study_id: str) -> Study:
    study = session.scalar(select(Study).where(Study.id == study_id)) if is_text(study_id) else None
    if study is None:
        raise InputError(
            f"there is no study {study_id!r} in this database: 'drapemeter study list' shows them", code="study_unknown"
        )
    return study


def _lock(session: Session, table: type[Study] | type[StudyParticipant], number: int) -> None:
    """One writer at a time where the database does not see to it by itself (SQLite does)."""
    session.execute(select(table.number).where(table.number == number).with_for_update())
