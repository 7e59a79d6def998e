"""The benchmark fabrics of ``docs/benchmarks.md``."""

from __future__ import annotations

from simcore.parameters import FabricParameters

FABRICS = {
    "vstiff": FabricParameters(3000, 3000, 3000, 1e-3, 1e-3, 1e-3, 0.2),
    "stiff": FabricParameters(3000, 2500, 1000, 2.5e-4, 2.5e-4, 2.5e-4, 0.4),
    "medium": FabricParameters(1000, 800, 300, 1.5e-5, 1.5e-5, 1.5e-5, 0.2),
    "soft": FabricParameters(300, 200, 100, 1e-6, 1e-6, 1e-6, 0.1),
}
