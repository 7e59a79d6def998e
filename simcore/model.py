"""Energy, gradient and Hessian of a batch of cloths: the kernels with their scratch fields."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from simcore import curl_kernels, kernels, skew_kernels
from simcore.cloths import Cloths
from simcore.grid import Grid
from simcore.launch import Launch


class Model:
    """Launches the kernels for up to ``most`` cloths at once.

    Args:
        grid: of every cloth.
        most: largest number of positions a call gets.
        zeros: makes a float64 array of a shape where the kernels run (NumPy, or tensors of a device).
    """

    def __init__(
        self,
        grid: Grid,
        most: int,
        zeros: Callable[..., Any],
    ) -> None:
        rows, columns = grid.rows, grid.columns
        self._zeros = zeros
        self._parts = zeros((most, rows, columns))
        self._forces = zeros((most, rows - 1, columns - 1, 3, 3))
        self._blocks = zeros((most, rows - 1, columns - 1, 6, 3, 3))
        self._stencil = zeros((most, rows, columns, 7, 3, 3))
        self._energies, self._gradients = Launch(kernels.energies), Launch(kernels.gradients)
        self._hessians = Launch(kernels.hessians)
        self._curl_energies = Launch(curl_kernels.curl_energies)
        self._curl_gradients = Launch(curl_kernels.curl_gradients)
        self._curl_hessians = Launch(curl_kernels.curl_hessians)
        self._skew_energies = Launch(skew_kernels.skew_energies)
        self._skew_gradients = Launch(skew_kernels.skew_gradients)
        self._curl: Any = None
        self._curl_blocks: Any = None

    @staticmethod
    def _first(scratch: Any, x: Any) -> Any:
        """As many leading entries as there are positions; the whole is handed over itself, which launches cheaper."""
        return scratch if len(scratch) == len(x) else scratch[: len(x)]

    def energies(self, cloths: Cloths, which: Any, x: Any) -> Any:
        """[J], shape [n]; ``panel_kernels.BEHIND`` and more where a vertex is behind the panel.

        Args:
            cloths: constant fields.
            which: the cloth of each position, int32 [n].
            x: positions [n, rows, columns, 3].
        """
        out = self._zeros((len(x),))
        parts = self._first(self._parts, x)
        self._energies(
            which, x, cloths.settings, cloths.hourglass, cloths.bending, cloths.load, cloths.fixed, cloths.panel, parts,
            out,
        )  # fmt: skip
        if cloths.moments is not None:
            self._curl_energies(which, x, cloths.moments, parts, out)
        if cloths.skew is not None:
            self._skew_energies(which, x, cloths.skew, parts, out)
        return out

    def gradients(self, cloths: Cloths, which: Any, x: Any) -> Any:
        """Derivatives of the energies [N], zero where held, [n, rows, columns, 3]."""
        out = self._zeros(tuple(x.shape))
        self._gradients(
            which, x, cloths.settings, cloths.hourglass, cloths.bending, cloths.load, cloths.fixed, cloths.panel,
            self._first(self._forces, x), out,
        )  # fmt: skip
        if cloths.moments is not None:
            if self._curl is None:
                self._curl = self._zeros((*self._parts.shape, 3, 3))
            self._curl_gradients(which, x, cloths.moments, cloths.fixed, self._first(self._curl, x), out)
        if cloths.skew is not None:
            self._skew_gradients(which, x, cloths.skew, cloths.fixed, out)
        return out

    def hessians(self, cloths: Cloths, which: Any, x: Any, blend: Any, shift: Any) -> Any:
        """Second derivatives as stencils [n, rows, columns, 7, 3, 3] [N/m], a view that the next call overwrites.

        Without ``Cloths.skew_between_free``, which depends on no positions.

        Args:
            cloths, which, x: as above.
            blend: of each, 1 for the exact Hessian, 0 for one that is positive semi-definite [n].
            shift: added to the diagonal [n, rows, columns].
        """
        out = self._first(self._stencil, x)
        self._hessians(
            which, x, cloths.settings, cloths.hourglass, cloths.bending, cloths.fixed, cloths.panel, blend, shift,
            self._first(self._blocks, x), out,
        )  # fmt: skip
        if cloths.moments is not None and float(blend.max()) > 0.0:
            if self._curl_blocks is None:
                self._curl_blocks = self._zeros((*self._parts.shape, 5, 3, 3))
            self._curl_hessians(which, x, cloths.moments, blend, cloths.fixed, self._first(self._curl_blocks, x), out)
        return out
