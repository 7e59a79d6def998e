"""From the three stated rigidities to the coefficients of an orthotropic plate."""

from __future__ import annotations

import math
from dataclasses import dataclass

from simcore.parameters import FabricParameters

COUPLING = 0.3
"""Share of sqrt(B_warp B_weft) that couples the two curvatures where the bias rigidity leaves the choice."""
ADMISSIBLE = 0.98


@dataclass(frozen=True)
class PlateRigidity:
    """Energy per area ½(weft κ_uu² + warp κ_vv² + 2 coupling κ_uu κ_vv + 4 twist κ_uv²), all [N·m].

    ``bias_raised`` says that the stated bias rigidity was below what an elastic plate can have and was raised to it.
    """

    weft: float
    warp: float
    coupling: float
    twist: float
    bias_raised: bool

    @classmethod
    def of(cls, fabric: FabricParameters) -> PlateRigidity:
        """A cylinder bent along warp, weft or the 45° bias stores ½ B κ² with the stated B.

        In between B(t) = B_warp cos⁴t + B_weft sin⁴t + X sin²t cos²t with X = 4 B_bias - B_warp - B_weft, the only form
        a quadratic plate energy can have; it is positive for every direction when X > -2 sqrt(B_warp B_weft).
        """
        warp, weft = fabric.bending_warp, fabric.bending_weft
        root = math.sqrt(warp * weft)
        mixed = 4.0 * fabric.bending_bias - warp - weft
        lowest = -2.0 * ADMISSIBLE * root
        raised = mixed < lowest
        mixed = max(mixed, lowest)
        coupling = min(COUPLING * root, 0.5 * mixed)
        return cls(weft, warp, coupling, 0.25 * (mixed - 2.0 * coupling), raised)

    def along(self, angle_from_warp: float) -> float:
        """Rigidity of a cylinder whose curvature runs at this angle [rad] from warp [N·m]."""
        c2, s2 = math.cos(angle_from_warp) ** 2, math.sin(angle_from_warp) ** 2
        return self.warp * c2 * c2 + self.weft * s2 * s2 + (2.0 * self.coupling + 4.0 * self.twist) * s2 * c2

    def turned(self, angle: float) -> PlateRigidity:
        """The same plate with its material axes turned by ``angle`` [rad] against the sample.

        The terms that then couple bending with twist (D16, D26; nil for an isotropic fabric) are left out: the 13-point
        stencil cannot hold them. Rigidities along the sample's axes and the mean of the two diagonals are exact.
        """
        if angle == 0.0:
            return self
        c2, s2 = math.cos(angle) ** 2, math.sin(angle) ** 2
        cross = self.coupling + 2.0 * self.twist
        weft = self.weft * c2 * c2 + self.warp * s2 * s2 + 2.0 * cross * s2 * c2
        warp = self.weft * s2 * s2 + self.warp * c2 * c2 + 2.0 * cross * s2 * c2
        shared = (self.weft + self.warp - 2.0 * cross) * s2 * c2
        return PlateRigidity(weft, warp, self.coupling + shared, self.twist + shared, self.bias_raised)
