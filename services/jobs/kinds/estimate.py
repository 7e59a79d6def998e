"""Job ``estimate``: a fabric's mechanics from captures that show effects, by simulations that show them, too."""

from __future__ import annotations

import json
from typing import Any

from pydantic import Field

from diagnosis.extension import SimulatorExtension
from services.estimates import estimate_fields, poses_note, simulated_fields
from services.jobs.sent_pictures import load_sent
from services.jobs.task import Report, Task, TaskOutput
from services.model_folder import load_model, require_model
from services.schemas import Strict
from simcore.parameters import ESTIMATED_NAMES, UNITS


class EstimateInputs(Strict):
    """What goes with the uploaded pictures."""

    document: dict[str, Any] = Field(description="The `captures.json` of one fabric, whose density it states.")
    simulator: SimulatorExtension


def run(task: Task, report: Report) -> TaskOutput:
    """Estimate with the effects in the simulations.

    Raises:
        DrapemeterError: captures that cannot be used or simulated, or no model.
    """
    from capture.pose_notes import PoseNotes
    from capture.prepare import prepare_all
    from diagnosis.indirect_estimate import IndirectEstimator
    from diagnosis.simulation.drape_cache import DrapeCache
    from diagnosis.simulation.simulator import Simulator

    inputs = EstimateInputs.model_validate(task.inputs)
    estimator, notes, drapes = load_model(require_model(task.resources.model)), PoseNotes(), DrapeCache.default()
    pictures = {file.name: file.content for file in task.files}
    captures = load_sent(task.scratch, json.dumps(inputs.document), pictures)
    prepared = notes.heard(prepare_all(captures.captures))
    indirect = IndirectEstimator(captures, prepared, inputs.simulator, estimator, Simulator(drapes))
    ((fabric, of_fabric),) = captures.fabrics.items()
    assert of_fabric.density is not None
    found = indirect.estimate(fabric, of_fabric.density, on_step=lambda share: report(share, "simulating"))
    drapes.trim()
    said = [*notes.of_fabric(fabric), *poses_note(indirect.in_poses)]
    return TaskOutput(
        {
            **estimate_fields(found.estimate, said),
            "units": {name: UNITS[name] for name in ESTIMATED_NAMES},
            "density": of_fabric.density,
            "model_version": estimator.version,
            "simulator": inputs.simulator.model_dump(mode="json"),
            "simulated": simulated_fields(found),
        }
    )
