"""Models that requests, jobs and answers share."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from simcore.json_text import whole
from simcore.parameters import LIMITS, UNITS, FabricParameters

EXAMPLE_PARAMETERS: dict[str, Any] = {
    "stretch_warp": 1000.0,
    "stretch_weft": 800.0,
    "stretch_bias": 300.0,
    "bending_warp": 1.5e-5,
    "bending_weft": 1.2e-5,
    "bending_bias": 1.0e-5,
    "density": 0.2,
}
EXAMPLE_STIFF: dict[str, Any] = {**EXAMPLE_PARAMETERS, "bending_warp": 2.5e-4, "bending_weft": 2.0e-4, "density": 0.4}

# a text or a truth value is no number, though pydantic would take "2" and true for one
Number = Annotated[float, Field(strict=True)]
Whole = Annotated[int, Field(strict=True), BeforeValidator(whole)]


class Strict(BaseModel):
    """A request body: unknown fields are refused, so that a misspelt one is noticed."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def _bounded(name: str) -> Any:
    low, high = LIMITS[name]
    return Field(ge=low, le=high, description=f"{UNITS[name]}", examples=[EXAMPLE_PARAMETERS[name]], strict=True)


class Parameters(Strict):
    """The seven fabric parameters, SI units. Other keys are passed over, as the contract allows them; none of the seven
    can be misspelt unnoticed, since all are needed."""

    model_config = ConfigDict(extra="ignore", json_schema_extra={"examples": [EXAMPLE_PARAMETERS]})

    stretch_warp: Annotated[float, _bounded("stretch_warp")]
    stretch_weft: Annotated[float, _bounded("stretch_weft")]
    stretch_bias: Annotated[float, _bounded("stretch_bias")]
    bending_warp: Annotated[float, _bounded("bending_warp")]
    bending_weft: Annotated[float, _bounded("bending_weft")]
    bending_bias: Annotated[float, _bounded("bending_bias")]
    density: Annotated[float, _bounded("density")]

    def to_fabric(self) -> FabricParameters:
        """The same as simcore's type."""
        return FabricParameters.from_mapping(self.model_dump())
