"""Parameters of a set's fabrics: as stated, or estimated from their captures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING

from capture.documents import FabricDocument
from capture.prepare import PreparedCapture, inputs_by_fabric
from diagnosis.tasks.fabric_task import STATED_DENSITY_SIGMA, relative_sigma
from simcore.bending import raised_bias
from simcore.parameters import ESTIMATED_NAMES, FabricParameters

if TYPE_CHECKING:
    from trainer.predict import Estimate, Estimator

UNKNOWN_SIGMA = 0.8
"""Relative uncertainty of parameters that nothing is known of (linear responses are not good for more)."""
UNKNOWN_DENSITY_SIGMA = 0.5
LEAST_ESTIMATED_SIGMA = 0.15
"""An estimate from the very captures that are to be explained takes part of an effect for the fabric."""
FOREIGN_SPREAD = 1.5
"""What estimates are off by on captures that the estimator's own simulator did not make, in what its intervals say.

Root mean square 0.9 on a third simulator's set with nothing in it, 1.3 with an effect on the cloth, 1.7 with one on
camera or sensor."""
STATED_SIGMA = 0.07
"""Relative uncertainty of parameters that a set states without saying how well they are known."""
TYPICAL_DENSITY_KG_M2 = 0.2
INTERVAL_90 = 1.645
"""Half a 90 % interval in standard deviations."""


def stated_parameters(
    fabric: FabricDocument, prepared: Sequence[PreparedCapture], assumed: list[str]
) -> tuple[FabricParameters, tuple[float, ...]]:
    """A fabric's parameters and their relative uncertainty [7], as stated or estimated from its captures.

    What had to be assumed is appended to ``assumed``.
    """

    def usable(name: str, cv: float) -> float:
        if cv > UNKNOWN_SIGMA:
            assumed.append(
                f"fabric {fabric.id}: {name} {cv:g} is taken as {UNKNOWN_SIGMA}, the most that can be used (it is a "
                "share: 0.07 for 7 %)"
            )
        return min(cv, UNKNOWN_SIGMA)

    density, density_cv = fabric.density, fabric.density_cv
    if density is None:
        assumed.append(f"fabric {fabric.id}: no density; taken as {TYPICAL_DENSITY_KG_M2} kg/m², give or take a half")
        density, density_cv = TYPICAL_DENSITY_KG_M2, UNKNOWN_DENSITY_SIGMA
    if density_cv is not None:
        density_cv = usable("density_cv", density_cv)
    if fabric.parameters is not None:
        given = fabric.parameters.model_dump()
        cv = STATED_SIGMA if fabric.parameters_cv is None else usable("parameters_cv", fabric.parameters_cv)
        stated = FabricParameters.from_mapping({**given, "density": density})
        if (raised := raised_bias(stated)) is not None:
            assumed.append(f"fabric {fabric.id}: {raised}")
        return stated, relative_sigma(cv, density_cv)
    found = shipped_estimator().estimate_named(fabric.id, inputs_by_fabric(prepared)[fabric.id], density)
    assumed.append(
        f"fabric {fabric.id}: no parameters; estimated from its captures ({found.model_version}"
        + (", which are unlike what the estimator knows)" if found.out_of_distribution else ")")
    )
    parameters = FabricParameters.from_mapping({**found.parameters, "density": density})
    return parameters, (*uncertainty(found), STATED_DENSITY_SIGMA if density_cv is None else density_cv)


def uncertainty(found: Estimate) -> tuple[float, ...]:
    """Relative uncertainty of an estimate's six parameters."""
    spread = [
        0.5 * math.log(high / low) / INTERVAL_90 for low, high in (found.intervals_90[n] for n in ESTIMATED_NAMES)
    ]
    if found.out_of_distribution:
        spread = [max(value, UNKNOWN_SIGMA) for value in spread]
    return tuple(min(FOREIGN_SPREAD * max(value, LEAST_ESTIMATED_SIGMA), UNKNOWN_SIGMA) for value in spread)


@cache
def shipped_estimator() -> Estimator:
    """The network that ships; loaded once."""
    from trainer.predict import Estimator
    from trainer.shipped import DEFAULT_MODEL

    return Estimator.load(DEFAULT_MODEL)
