"""Job ``diagnosis``: a capture set against simulations of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from services.jobs.archive import ArchiveLimits, unpack
from services.jobs.files import FileContent
from services.jobs.kinds.common import counting
from services.jobs.task import Report, Task, TaskOutput
from services.schemas import Strict
from simcore.mesh import GridMesh

if TYPE_CHECKING:
    from diagnosis.diagnose import DiagnosisOptions

ARCHIVE_NAME = "capture-set.zip"


class DiagnosisInputs(Strict):
    """What goes with the uploaded archive."""

    effects: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    resolution_m: float = 0.01
    most_bytes: int = Field(description="How much the archive may unpack to.")

    def options(self) -> DiagnosisOptions:
        """The same for :mod:`diagnosis`, checked.

        Raises:
            InputError: an unknown effect, none left, or a resolution that does not cut the sample into whole cells.
        """
        from diagnosis.diagnose import DiagnosisOptions

        GridMesh(self.resolution_m)
        options = DiagnosisOptions(self.effects, self.without, self.resolution_m)
        options.chosen()
        return options


def run(task: Task, report: Report) -> TaskOutput:
    """Unpack, diagnose, and keep both forms of the report.

    Raises:
        DrapemeterError: captures that cannot be used, or simulations that do not come to rest.
    """
    from capture.capture_set import CaptureSet
    from diagnosis.diagnose import diagnose
    from diagnosis.pages.html import render_html

    inputs = DiagnosisInputs.model_validate(task.inputs)
    options = inputs.options()
    unpack(task.file(ARCHIVE_NAME), task.scratch, ArchiveLimits(inputs.most_bytes))
    captures = CaptureSet.load(task.scratch)
    shown = {capture.fabric.id for capture in captures.captures}
    advance = counting(report, len(shown), "fabrics")
    found = diagnose(captures, options, on_fabric=lambda _: advance())
    page = render_html(found, captures.document.name or "capture set")
    return TaskOutput(found.report.as_json(), (FileContent("report.html", "text/html", page.encode()),))
