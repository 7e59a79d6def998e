"""Sparse symmetric factorisation: a thin wrapper of oneMKL's PARDISO (one thread, real symmetric).

The inertia that the factorisation reports is what certifies a minimum. Source: oneMKL Developer Reference, ``pardiso``.
"""

from __future__ import annotations

import ctypes
import os
import weakref
from functools import cache
from importlib import metadata

import numpy as np
from numpy.typing import NDArray

from simcore.errors import MissingResourceError, OutOfMemoryError, SimulationError

_POSITIVE_DEFINITE, _INDEFINITE = 2, -2
"""Kinds of real symmetric matrices."""
_SEQUENTIAL = 1
"""The threading layer without threads."""
_FACTOR = 22
"""Phase of the numerical factorisation."""
_OUT_OF_MEMORY, _ZERO_PIVOT = -2, -4
"""Errors; the second is also what Cholesky says of a matrix that is not positive definite."""
_ERRORS = {
    -1: "its input is inconsistent",
    -3: "the equations could not be ordered",
    -7: "the diagonal is singular",
    -8: "an integer overflowed",
}


@cache
def _library() -> ctypes.CDLL:
    os.environ.setdefault("MKL_THREADING_LAYER", "SEQUENTIAL")
    os.environ.setdefault("MKL_NUM_THREADS", "1")
    try:
        files = metadata.files("mkl") or []
    except metadata.PackageNotFoundError:
        files = []
    for file in files:
        if file.name.startswith("libmkl_rt.so"):
            library = ctypes.CDLL(str(file.locate()))
            # whatever MKL_THREADING_LAYER says: sums that several threads share have other last bits
            library.MKL_Set_Threading_Layer(ctypes.c_int(_SEQUENTIAL))
            return library
    raise MissingResourceError("oneMKL is not installed: pip install mkl (x86-64 only)", code="mkl_missing")


def _pointer(array: NDArray[np.generic]) -> ctypes.c_void_p:
    return array.ctypes.data_as(ctypes.c_void_p)


def _release(handle: NDArray[np.int64], settings: NDArray[np.int32], kind: int, n: int) -> None:
    def reference(value: int) -> ctypes._CArgObject:
        return ctypes.byref(ctypes.c_int(value))

    unused = np.zeros(1)
    none = _pointer(unused)
    _library().pardiso(
        _pointer(handle), reference(1), reference(1), reference(kind), reference(-1),
        reference(n), none, none, none, none, reference(1), _pointer(settings), reference(0), none, none, reference(0),
    )  # fmt: skip


class Factorisation:
    """LDLᵀ (double precision) or Cholesky (single) of a symmetric matrix whose pattern stays and whose values change.

    Args:
        indptr: CSR row starts of the upper triangle, zero-based, int32, shape [n + 1].
        indices: CSR column indices, sorted, each row starting with its diagonal, int32, shape [nonzeros].
        single: factor in single precision: half the time and memory; good for a direction, not for a certificate.
        order: the equations as they are eliminated, int32, shape [n]; None: by PARDISO's minimum degree.

    Raises:
        OutOfMemoryError: from each method: there was not enough memory.
        SimulationError: from each method: PARDISO failed otherwise.
    """

    def __init__(
        self,
        indptr: NDArray[np.int32],
        indices: NDArray[np.int32],
        single: bool = False,
        order: NDArray[np.int32] | None = None,
    ) -> None:
        self.n = len(indptr) - 1
        self._real = np.float32 if single else np.float64
        self._kind = _POSITIVE_DEFINITE if single else _INDEFINITE
        self._ia = (indptr + 1).astype(np.int32)
        self._ja = (indices + 1).astype(np.int32)
        self._values: NDArray[np.floating] = np.ones(len(indices), dtype=self._real)
        self._handle = np.zeros(64, dtype=np.int64)
        self._settings = np.zeros(64, dtype=np.int32)
        self._settings[0] = 1  # these settings, not the defaults
        self._settings[1] = 0  # minimum degree: a quarter fewer operations here than nested dissection
        self._settings[4] = int(order is not None)
        self._settings[9] = 6 if single else 12  # pivot perturbation 1e-6 or 1e-12
        self._settings[7] = 0  # no iterative refinement
        self._settings[27] = int(single)
        self._permutation = np.zeros(self.n, dtype=np.int32) if order is None else order + np.int32(1)
        self._unused = np.zeros(1)
        self._all = self._arguments()
        self._call(11)
        self._held = False
        # gives PARDISO's memory back with the object; at the end of the process the system does
        weakref.finalize(self, _release, self._handle, self._settings, self._kind, self.n).atexit = False

    def _arguments(self) -> tuple[object, ...]:
        """What each call of PARDISO gets, made once: only what these name changes from call to call."""
        self._places = {name: ctypes.c_void_p() for name in ("values", "right", "out")}
        self._counts = {name: ctypes.c_int() for name in ("phase", "sides", "error")}
        one, none = ctypes.byref(ctypes.c_int(1)), ctypes.byref(ctypes.c_int(0))
        kind, size = ctypes.byref(ctypes.c_int(self._kind)), ctypes.byref(ctypes.c_int(self.n))
        places, counts = self._places, {name: ctypes.byref(count) for name, count in self._counts.items()}
        return (
            _pointer(self._handle), one, one, kind, counts["phase"], size, places["values"], _pointer(self._ia),
            _pointer(self._ja), _pointer(self._permutation), counts["sides"], _pointer(self._settings), none,
            places["right"], places["out"], counts["error"],
        )  # fmt: skip

    def _call(
        self, phase: int, right: NDArray[np.floating] | None = None, out: NDArray[np.floating] | None = None
    ) -> int:
        self._counts["phase"].value = phase
        self._counts["sides"].value = 1 if right is None or right.ndim == 1 else len(right)
        self._places["values"].value = self._values.ctypes.data
        self._places["right"].value = (self._unused if right is None else right).ctypes.data
        self._places["out"].value = (self._unused if out is None else out).ctypes.data
        self._counts["error"].value = 0
        _library().pardiso(*self._all)
        error = self._counts["error"].value
        if error == 0 or (phase == _FACTOR and error == _ZERO_PIVOT):
            return error
        if error == _OUT_OF_MEMORY:
            raise OutOfMemoryError(
                f"out of memory: {self.n} equations of a mesh could not be solved: use coarser cells, or run fewer "
                "processes side by side",
                code="factorisation_failed",
            )
        raise SimulationError(
            f"{self.n} equations of a mesh could not be solved: {_ERRORS.get(error, 'an error inside the library')} "
            f"(PARDISO {error} in phase {phase}): use coarser cells",
            code="factorisation_failed",
        )

    def factor(self, values: NDArray[np.float64]) -> int:
        """Factor the matrix with these nonzeros.

        Args:
            values: float64, shape [nonzeros].

        Returns:
            The number of negative eigenvalues; ``n`` when a pivot was zero, or negative where Cholesky met it. There
            are no factors to solve with then.

        Raises:
            OutOfMemoryError: there was not enough memory.
            SimulationError: PARDISO failed otherwise.
        """
        self._values = values.astype(self._real, copy=False)
        self._held = True
        if self._call(_FACTOR) != 0:
            return self.n
        perturbed = int(self._settings[13])
        return int(self._settings[22]) + perturbed

    def forget(self) -> None:
        """Give back the memory of the last factors; the analysis of the pattern stays."""
        if self._held:
            self._call(0)
            self._held = False

    def solve(self, right: NDArray[np.float64]) -> NDArray[np.float64]:
        """Solve with the last factorisation for one or several right sides; float64, shape [n] or [sides, n]."""
        if self._real is np.float64:
            right = np.ascontiguousarray(right)
            out = np.empty_like(right)
            self._call(33, right, out)
            return out
        scale = float(np.abs(right).max(initial=0.0)) or 1.0  # forces near rest are too small for single precision
        small = np.ascontiguousarray(right / scale, dtype=np.float32)
        rough = np.empty_like(small)
        self._call(33, small, rough)
        return rough.astype(np.float64) * scale
