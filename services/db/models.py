"""All tables together; a new table is imported here and gets a migration in ``migrations/versions``."""

from __future__ import annotations

from services.db.api_keys import ApiKey
from services.db.base import Base
from services.db.fabrics import Fabric
from services.db.idempotency import IdempotencyRecord
from services.db.jobs import Job, JobFile, JobStatus, Worker
from services.db.studies import Study, StudyAnswer, StudyFabric, StudyParticipant, StudyPicture

__all__ = [
    "ApiKey",
    "Base",
    "Fabric",
    "IdempotencyRecord",
    "Job",
    "JobFile",
    "JobStatus",
    "Study",
    "StudyAnswer",
    "StudyFabric",
    "StudyParticipant",
    "StudyPicture",
    "Worker",
]
