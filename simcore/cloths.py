"""What the kernels know of each cloth of a batch: constant fields with one leading axis."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simcore.bending import PlateRigidity
from simcore.bending_forms import BendingForms
from simcore.contact import PanelContact
from simcore.grid import SKEW_OFFSETS, Grid
from simcore.loads import Load, rest_moments
from simcore.mechanics import Mechanics
from simcore.membrane_kernels import HOURGLASS
from simcore.parameters import FabricParameters

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Cloths:
    """Fields of ``b`` cloths on one grid; NumPy arrays, or tensors of a device after :meth:`on`.

    Attributes:
        settings: numbers of ``membrane_kernels`` [b, 10].
        hourglass: share of the full hourglass stiffness of each cell [b, rows-1, columns-1].
        bending: stencils of the bending form [b, rows, columns, 7] [N/m].
        load: constant forces [b, rows, columns, 3] [N].
        fixed: 1 where held, int32 [b, rows, columns].
        panel: numbers of ``panel_kernels`` [b, rows, columns, 7].
        moments: of rest curvature [b, rows, columns, 2] [N]; None when no cloth has any.
        skew: of the bending form, what ``skew_kernels`` add [b, rows, columns, 4] [N/m]; None when no cloth has any.
    """

    settings: Any
    hourglass: Any
    bending: Any
    load: Any
    fixed: Any
    panel: Any
    moments: Any = None
    skew: Any = None

    @classmethod
    def one(
        cls,
        grid: Grid,
        forms: BendingForms,
        fabric: FabricParameters,
        mechanics: Mechanics,
        contact: PanelContact,
        fixed: NDArray[np.int32],
    ) -> Cloths:
        """The fields of a single cloth."""
        angle = mechanics.off_grain_rad
        plate = PlateRigidity.of(fabric).turned(angle)
        stiffening = 0.0 if mechanics.stiffening_strain is None else mechanics.stiffening_strain**-2
        stretch = (fabric.stretch_weft, fabric.stretch_warp, fabric.stretch_bias)
        settings = np.array(
            [*stretch, math.cos(angle), math.sin(angle), stiffening, grid.hu, grid.hv, contact.adhesion_range_m,
             float(contact.active)]
        )  # fmt: skip
        touched = fixed[:-1, :-1] + fixed[:-1, 1:] + fixed[1:, :-1] + fixed[1:, 1:]
        moments = rest_moments(grid, plate, mechanics)
        bending, skew = forms.stencil(plate)
        return cls(
            settings[None],
            np.where(touched > 0, 1.0, HOURGLASS)[None],
            bending[None],
            Load.of(grid, fabric, mechanics).force[None],
            np.ascontiguousarray(fixed[None], dtype=np.int32),
            contact.numbers()[None],
            None if moments is None else moments[None],
            None if skew is None else skew[None],
        )

    @classmethod
    def stack(cls, cloths: Sequence[Cloths]) -> Cloths:
        """Several cloths of one grid as one batch."""
        columns = {}
        for name in (f.name for f in fields(cls)):
            parts = [getattr(c, name) for c in cloths]
            some = next((part for part in parts if part is not None), None)
            if some is not None:  # a cloth without has none of it beside one with
                columns[name] = np.concatenate([np.zeros_like(some) if part is None else part for part in parts])
        return cls(**columns)

    def on(self, place: Callable[[Any], Any]) -> Cloths:
        """The same with every array sent through ``place``."""
        moved = {f.name: place(getattr(self, f.name)) for f in fields(self) if getattr(self, f.name) is not None}
        return replace(self, **moved)

    def only(self, n: int) -> Cloths:
        """Cloth ``n`` as a batch of one."""
        parts = {f.name: getattr(self, f.name)[n : n + 1] for f in fields(self) if getattr(self, f.name) is not None}
        return replace(self, **parts)

    def skew_between_free(self, which: Any = slice(None)) -> Any:
        """``skew`` of the cloths ``which``, nil to and from held vertices: that part of their Hessians."""
        free = 1 - self.fixed[which]
        rows, columns = free.shape[1:]
        out = self.skew[which] * free[..., None]
        for m, (dj, di) in enumerate(SKEW_OFFSETS):
            left, right = max(0, -di), columns - max(0, di)
            out[:, : rows - dj, left:right, m] *= free[:, dj:, left + di : right + di]
        return out
