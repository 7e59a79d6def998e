"""Job ``fabric_search``: the fabrics of the library that drape most like a reference."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import ConfigDict, Field

from services.jobs.files import FileContent
from services.jobs.kinds.common import SimulationInputs, counting, simulation_runner
from services.jobs.task import Report, Task, TaskOutput
from services.patterns import PRINTABLE
from services.schemas import EXAMPLE_PARAMETERS, Parameters, Whole
from simcore.errors import InputError

if TYPE_CHECKING:
    from metric.search import RankedFabric


class FabricSearchInputs(SimulationInputs):
    """What to look for: a fabric of the library, or seven parameters."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"reference": EXAMPLE_PARAMETERS, "limit": 5, "backend": "depth"}]}
    )

    reference: Parameters | None = Field(default=None, description="Parameters to look for.")
    fabric_id: str | None = Field(
        default=None, max_length=48, pattern=PRINTABLE, description="Or a fabric of the library."
    )
    limit: Whole = Field(default=10, ge=1, le=200, description="How many to return.")

    def check(self) -> None:
        """As for all simulations; exactly one reference is needed.

        Raises:
            InputError: none or both.
        """
        super().check()
        if (self.reference is None) == (self.fabric_id is None):
            raise InputError("give either reference or fabric_id", code="reference_missing")


def run(task: Task, report: Report) -> TaskOutput:
    """Simulate what is not cached, and rank.

    Raises:
        DrapemeterError: an empty library, unknown back end, weights missing, or a simulation that is not still.
    """
    from metric.backends import get_backend
    from metric.library import parse_library
    from metric.search import search_library
    from services.caches import shared_metric_caches
    from simcore.bending import raised_biases

    rows = task.inputs["library"]
    inputs = FabricSearchInputs.model_validate({k: v for k, v in task.inputs.items() if k != "library"})
    told = {row["id"]: {key: row[key] for key in ("id", "name", "plm_ref")} for row in rows}
    library = parse_library(rows, "the fabric library")
    if inputs.reference is not None:
        reference = inputs.reference.to_fabric()
    else:
        found = [entry for entry in library if entry.id == inputs.fabric_id]
        if not found:
            raise InputError(f"no fabric {inputs.fabric_id!r} in the library", code="fabric_unknown")
        reference = found[0].parameters
        library = [entry for entry in library if entry.id != inputs.fabric_id]
        if not library:
            raise InputError("the library holds no other fabric", code="library_empty")
    backend = get_backend(inputs.backend)
    caches = shared_metric_caches()
    found_fabrics = search_library(
        reference,
        library,
        backend,
        inputs.plan(),
        runner=simulation_runner(task.resources),
        renders=caches.renders,
        features=caches.features,
        descriptors=caches.descriptors,
        on_done=counting(report, 2 * inputs.simulations * (1 + len(library)), "simulations"),
    )
    simulated = [(inputs.fabric_id or "reference", reference), *((f.id, f.parameters) for f in library)]
    nearest = found_fabrics.ranking[: inputs.limit]
    thumbnails = [_thumbnails(place, fabric) for place, fabric in enumerate(nearest, start=1)]
    return TaskOutput(
        {
            "ranking": [
                {
                    **told[r.id],
                    "distance": r.distance,
                    "standard_error": r.standard_error,
                    "thumbnails": {scene: file.name for scene, file in files.items()},
                }
                for r, files in zip(nearest, thumbnails, strict=True)
            ],
            "failed": [{**told[f.id], "reason": f.reason} for f in found_fabrics.failed],
            "raised_bias": raised_biases(simulated),
            "searched": len(library),
            "simulations": inputs.simulations,
            "backend": backend.name,
            "unit": backend.unit,
        },
        tuple(file for files in thumbnails for file in files.values()),
    )


def _thumbnails(place: int, fabric: RankedFabric) -> dict[str, FileContent]:
    """A small PNG of the fabric in each scene, named by its place in the ranking."""
    from renderer.picture import png_bytes

    return {
        scene.value: FileContent(f"{place:03d}-{scene.value}.png", "image/png", png_bytes(picture))
        for scene, picture in fabric.pictures.items()
    }
