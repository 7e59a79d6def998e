"""Job ``diagnosis``: a capture set against simulations of it."""

from __future__ import annotations

from pathlib import PurePosixPath
from typing import TYPE_CHECKING

from pydantic import Field

from capture.documents import CaptureDocument, CaptureSetDocument, parse_document
from services.jobs.archive import CAPTURES_FILE, ArchiveLimits, read_captures_json, unpack
from services.jobs.files import FileContent
from services.jobs.task import Report, Task, TaskOutput
from services.schemas import Strict
from simcore.errors import InputError

if TYPE_CHECKING:
    from diagnosis.diagnose import DiagnosisOptions

ARCHIVE_NAME = "capture-set.zip"


class DiagnosisInputs(Strict):
    """What goes with the uploaded archive."""

    effects: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    resolution_m: float = 0.01
    lpips: bool = False
    most_bytes: int = Field(description="How much the archive may unpack to.")

    def options(self) -> DiagnosisOptions:
        """The same for :mod:`diagnosis`, checked.

        Raises:
            InputError: an unknown effect, or none left.
        """
        from diagnosis.diagnose import DiagnosisOptions

        options = DiagnosisOptions(self.effects, self.without, self.resolution_m, lpips=self.lpips)
        options.chosen()
        return options


def picture_name(capture: CaptureDocument) -> str:
    """Where an archive has a capture's depth picture, relative to its ``captures.json``."""
    return PurePosixPath(capture.depth).as_posix()


def picture_names(document: CaptureSetDocument) -> dict[str, str]:
    """Where an archive has the depth pictures, relative to its ``captures.json``, with what that calls them.

    Raises:
        InputError: a path that goes up.
    """
    names = {picture_name(capture): capture.depth for capture in document.captures}
    upward = [depth for name, depth in names.items() if ".." in PurePosixPath(name).parts]
    if upward:
        raise InputError(
            f"{CAPTURES_FILE} names {upward[0]}: in an archive a picture's path must not go up (..)",
            code="depth_missing",
        )
    return names


def run(task: Task, report: Report) -> TaskOutput:
    """Unpack, diagnose, and keep both forms of the report.

    Raises:
        DrapemeterError: captures that cannot be used, or simulations that do not come to rest.
    """
    from capture.capture_set import CaptureSet
    from diagnosis.diagnose import diagnose
    from diagnosis.pages.html import render_html
    from diagnosis.simulation.drape_cache import DrapeCache

    inputs = DiagnosisInputs.model_validate(task.inputs)
    options = inputs.options()
    content, limits = task.file(ARCHIVE_NAME), ArchiveLimits(inputs.most_bytes)
    document = parse_document(read_captures_json(content, limits), CAPTURES_FILE)
    unpack(content, task.scratch, limits, picture_names(document))
    captures = CaptureSet.load(task.scratch)
    drapes = DrapeCache.default()
    found = diagnose(captures, options, cache=drapes, on_step=report)
    page = render_html(found, captures.document.name or "capture set")
    found = found.recounted()
    drapes.trim()
    return TaskOutput(found.report.as_json(), (FileContent("report.html", "text/html", page.encode()),))
