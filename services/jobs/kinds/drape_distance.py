"""Job ``drape_distance``: how alike two fabrics drape."""

from __future__ import annotations

from pydantic import ConfigDict, Field

from services.jobs.kinds.common import SimulationInputs, counting, simulation_runner
from services.jobs.task import Report, Task, TaskOutput
from services.schemas import EXAMPLE_PARAMETERS, EXAMPLE_STIFF, Parameters


class DrapeDistanceInputs(SimulationInputs):
    """Two fabrics to compare."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [{"a": EXAMPLE_PARAMETERS, "b": EXAMPLE_STIFF, "simulations": 5, "backend": "depth"}]
        }
    )

    a: Parameters = Field(description="One fabric.")
    b: Parameters = Field(description="The other.")


def run(task: Task, report: Report) -> TaskOutput:
    """Simulate both fabrics and compare their pictures.

    Raises:
        DrapemeterError: unknown back end, weights missing, or a simulation that does not come to rest.
    """
    from metric.backends import get_backend
    from metric.compare import compare_fabrics
    from services.caches import shared_metric_caches
    from simcore.bending import raised_biases

    inputs = DrapeDistanceInputs.model_validate(task.inputs)
    backend = get_backend(inputs.backend)
    caches = shared_metric_caches()
    a, b = inputs.a.to_fabric(), inputs.b.to_fabric()
    comparison = compare_fabrics(
        a,
        b,
        backend,
        inputs.plan(),
        runner=simulation_runner(task.resources),
        renders=caches.renders,
        features=caches.features,
        on_done=counting(report, 4 * inputs.simulations, "simulations"),
    )
    found = comparison.result
    return TaskOutput(
        {
            "distance": found.distance,
            "standard_error": found.standard_error,
            "scenes": {scene.value: value for scene, value in found.scenes.items()},
            "simulations": inputs.simulations,
            "backend": found.backend,
            "unit": found.unit,
            "simulated_again": len(comparison.retries),
            "raised_bias": raised_biases([("a", a), ("b", b)]),
        }
    )
