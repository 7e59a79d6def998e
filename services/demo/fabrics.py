"""Made-up fabrics of the demonstration, in the range of what shirts to tents are made of."""

from __future__ import annotations

import numpy as np

from simcore.parameters import FabricParameters

NAMED: dict[str, FabricParameters] = {
    "voile": FabricParameters(300.0, 200.0, 60.0, 3e-6, 2e-6, 2.5e-6, 0.08),
    "poplin": FabricParameters(1000.0, 800.0, 150.0, 1.5e-5, 1e-5, 1.2e-5, 0.12),
    "twill": FabricParameters(1500.0, 900.0, 200.0, 6e-5, 3e-5, 4e-5, 0.25),
    "canvas": FabricParameters(3000.0, 2500.0, 400.0, 2.5e-4, 2e-4, 2.2e-4, 0.4),
}

_SWEPT = FabricParameters(800.0, 800.0, 150.0, 3e-5, 3e-5, 3e-5, 0.2)
BENDING_SWEEP: tuple[float, ...] = tuple(float(v) for v in np.geomspace(3e-6, 3e-4, 5))
"""Flexural rigidity of each column [N·m]."""
STRETCH_SWEEP: tuple[float, ...] = tuple(float(v) for v in np.geomspace(40.0, 4000.0, 5))
"""Warp and weft stiffness of each column [N/m]; the bias is a fifth of it."""


def bending_sweep() -> list[FabricParameters]:
    """One fabric whose bending grows a hundredfold."""
    values = _SWEPT.as_dict()
    return [
        FabricParameters(**{**values, "bending_warp": b, "bending_weft": b, "bending_bias": b}) for b in BENDING_SWEEP
    ]


def stretch_sweep() -> list[FabricParameters]:
    """One fabric whose stretch stiffness grows a hundredfold."""
    values = _SWEPT.as_dict()
    return [
        FabricParameters(**{**values, "stretch_warp": k, "stretch_weft": k, "stretch_bias": 0.2 * k})
        for k in STRETCH_SWEEP
    ]
