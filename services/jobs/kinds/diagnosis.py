"""Job ``diagnosis``: a capture set against simulations of it."""

from __future__ import annotations

from pydantic import Field

from services.jobs.archive import ArchiveLimits, unpack
from services.jobs.task import Report, Task, TaskOutput
from services.schemas import Strict

ARCHIVE_NAME = "capture-set.zip"


class DiagnosisInputs(Strict):
    """What goes with the uploaded archive."""

    seed: int = Field(default=0, ge=0)
    most_bytes: int = Field(description="How much the archive may unpack to.")


def run(task: Task, report: Report) -> TaskOutput:
    """Unpack, diagnose, and keep both forms of the report.

    Raises:
        DrapemeterError: captures that cannot be used, or simulations that do not come to rest.
    """
    from capture.capture_set import CaptureSet

    inputs = DiagnosisInputs.model_validate(task.inputs)
    folder = task.scratch / "captures"
    folder.mkdir()
    unpack(task.file(ARCHIVE_NAME), folder, ArchiveLimits(inputs.most_bytes))
    captures = CaptureSet.load(folder)
    report(0.0, f"{len(captures.captures)} captures")
    raise NotImplementedError
