"""From the three stated rigidities to the coefficients of an orthotropic plate."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from simcore.parameters import FabricParameters

COUPLING = 0.3
"""Share of sqrt(B_warp B_weft) that couples the two curvatures where the bias rigidity leaves the choice."""
ADMISSIBLE = 0.98


@dataclass(frozen=True)
class PlateRigidity:
    """Energy per area ½(weft κ_uu² + warp κ_vv² + 2 coupling κ_uu κ_vv + 4 twist κ_uv² + 4 weft_twist κ_uu κ_uv +
    4 warp_twist κ_vv κ_uv), all [N·m].

    These are D11, D22, D12, D66, D16 and D26 of a plate; the last two are nil along the material's own axes.
    ``bias_raised`` says that the stated bias rigidity was below what an elastic plate can have and was raised to it.
    """

    weft: float
    warp: float
    coupling: float
    twist: float
    bias_raised: bool
    weft_twist: float = 0.0
    warp_twist: float = 0.0

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

    @property
    def bias(self) -> float:
        """Rigidity of a cylinder bent along the 45° bias [N·m]."""
        return self.along(math.pi / 4.0)

    def along(self, angle_from_warp: float) -> float:
        """Rigidity of a cylinder whose curvature runs at this angle [rad] from warp (v) towards weft (u) [N·m]."""
        c, s = math.cos(angle_from_warp), math.sin(angle_from_warp)
        straight = self.warp * c**4 + self.weft * s**4 + (2.0 * self.coupling + 4.0 * self.twist) * s * s * c * c
        return straight + 4.0 * s * c * (self.weft_twist * s * s + self.warp_twist * c * c)

    def turned(self, angle: float) -> PlateRigidity:
        """The same plate with its material axes turned by ``angle`` [rad] against the sample, from u towards v."""
        if angle == 0.0:
            return self
        c, s = math.cos(angle), math.sin(angle)
        c2, s2 = c * c, s * s
        cross = self.coupling + 2.0 * self.twist
        weft = self.weft * c2 * c2 + self.warp * s2 * s2 + 2.0 * cross * s2 * c2
        warp = self.weft * s2 * s2 + self.warp * c2 * c2 + 2.0 * cross * s2 * c2
        shared = (self.weft + self.warp - 2.0 * cross) * s2 * c2
        weft_twist = c * s * (c2 * self.weft - s2 * self.warp - (c2 - s2) * cross)
        warp_twist = c * s * (s2 * self.weft - c2 * self.warp + (c2 - s2) * cross)
        return PlateRigidity(
            weft, warp, self.coupling + shared, self.twist + shared, self.bias_raised, weft_twist, warp_twist
        )


def raised_bias(fabric: FabricParameters) -> str | None:
    """In words, that a fabric is simulated with a larger ``bending_bias`` than stated; None where it is not."""
    plate = PlateRigidity.of(fabric)
    if not plate.bias_raised:
        return None
    return (
        f"no plate with its bending_warp and bending_weft has a bending_bias of {fabric.bending_bias:.3g} N·m; "
        f"simulated with {plate.bias:.3g} N·m, the least there is"
    )


def raised_biases(fabrics: Iterable[tuple[str, FabricParameters]]) -> dict[str, str]:
    """By name, what :func:`raised_bias` says of those of several fabrics that are not simulated as stated.

    Args:
        fabrics: name and parameters of each.
    """
    return {name: said for name, fabric in fabrics if (said := raised_bias(fabric)) is not None}
