"""Launches of a kernel from Python without looking every argument over each time."""

from __future__ import annotations

from typing import Any

import numpy as np

from simcore.lang import on_cpu, ti


class Launch:
    """Calls one kernel again and again, mostly with the arrays of the last call.

    Taichi takes 100 to 130 microseconds to look over ten arrays at every launch, as much as the work on a 26 x 26 grid.
    Here the arguments of the last launch are kept, and only arrays that are others are told anew. The kernel's
    arguments must all be arrays, NumPy's or PyTorch's. GPUs, whose launcher changes what is kept, and other versions of
    Taichi take the kernel's own call. Not thread-safe.
    """

    def __init__(self, kernel: Any) -> None:
        self._kernel = kernel
        self._last: tuple[Any, ...] = ()
        self._context: Any = None

    def __call__(self, *arrays: Any) -> None:
        """Launch; arrays must be contiguous and of the types the kernel states."""
        if not on_cpu() or (self._context is None and not self._prepare(arrays)):
            self._kernel(*arrays)
            return
        for place, (last, array) in enumerate(zip(self._last, arrays, strict=True)):
            if array is not last:
                self._tell(place, array)
        self._last = arrays  # kept alive: the context has their addresses
        self._program.launch_kernel(self._compiled, self._context)

    def _prepare(self, arrays: tuple[Any, ...]) -> bool:
        """Compile for such arguments; False where Taichi's inner calls are not the known ones."""
        try:
            inner = self._kernel._primal
            built = inner.compiled_kernels[inner.ensure_compiled(*arrays)]
            self._program = ti.lang.impl.get_runtime().prog
            self._compiled = self._program.compile_kernel(
                self._program.config(), self._program.get_device_caps(), built
            )
            self._depths = [getattr(a.annotation.dtype, "ndim", 0) for a in inner.arguments]
            context = built.make_launch_context()
            self._set = context.set_arg_external_array_with_shape
        except AttributeError:
            return False
        self._kinds = [(array.dtype, array.ndim) for array in arrays]
        self._context, self._last = context, (None,) * len(arrays)
        return True

    def _tell(self, place: int, array: Any) -> None:
        numpy = isinstance(array, np.ndarray)
        contiguous = array.flags.c_contiguous if numpy else array.is_contiguous()
        if (array.dtype, array.ndim) != self._kinds[place] or not contiguous:
            raise TypeError(f"argument {place} of a kernel must stay contiguous and of one type and number of axes")
        shape = tuple(array.shape[: array.ndim - self._depths[place]])  # without the axes of vectors and matrices
        self._set((place,), array.ctypes.data if numpy else array.data_ptr(), array.nbytes, shape, 0)
