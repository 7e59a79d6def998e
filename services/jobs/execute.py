"""Doing one job: the module of its kind, loaded in the process that does the work."""

from __future__ import annotations

import importlib
from dataclasses import replace
from typing import Any

from sqlalchemy.orm import Session

from services.jobs.task import Report, Task, TaskOutput
from services.plain_json import to_plain
from simcore.errors import InputError

KINDS: dict[str, str] = {
    "drape_distance": "services.jobs.kinds.drape_distance",
    "fabric_search": "services.jobs.kinds.fabric_search",
    "diagnosis": "services.jobs.kinds.diagnosis",
    "dataset": "services.jobs.kinds.dataset",
    "estimate": "services.jobs.kinds.estimate",
}
"""Each module offers ``run(task, report) -> TaskOutput``."""


def execute(task: Task, *, report: Report) -> TaskOutput:
    """Do a job.

    Raises:
        DrapemeterError: it cannot be done as asked.
    """
    try:
        output: TaskOutput = importlib.import_module(KINDS[task.kind]).run(task, report)
    except InputError as error:
        # Whoever sent the files knows their names, not our folders.
        raise InputError(str(error).replace(f"{task.scratch}/", ""), code=error.code) from None
    return replace(output, result=to_plain(output.result))  # numbers that JSON does not have become null


def gather(session: Session, kind: str, inputs: dict[str, Any]) -> dict[str, Any]:
    """Add what a job needs from the database; only searching needs anything."""
    if kind != "fabric_search":
        return inputs
    from services.jobs.library import load_library

    return {**inputs, "library": load_library(session)}
