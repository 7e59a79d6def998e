"""Where a batch is computed: Taichi's runtime and PyTorch's tensors on one device."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from simcore import lang
from simcore.errors import MissingResourceError

Tensor = torch.Tensor


class Device:
    """Tensors that Taichi's kernels read and write in place.

    Both queue their work on CUDA's default stream, so neither need wait for the other.

    Args:
        arch: ``cuda`` or ``cpu``.

    Raises:
        MissingResourceError: ``cuda`` is asked for and PyTorch sees no such device.
    """

    def __init__(self, arch: str) -> None:
        if arch == "cuda" and not torch.cuda.is_available():
            raise MissingResourceError(
                "PyTorch sees no CUDA device: install its CUDA build on a machine with an NVIDIA GPU, or use arch cpu",
                code="cuda_missing",
            )
        lang.start(arch)
        self.arch = arch
        self.torch = torch.device(arch)

    @contextmanager
    def one_thread(self) -> Iterator[None]:
        """On ``cpu`` let PyTorch use one thread, as Taichi does: a worker owns a core."""
        if self.arch == "cuda":
            yield
            return
        before = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            yield
        finally:
            torch.set_num_threads(before)

    def zeros(self, shape: Sequence[int]) -> Tensor:
        """Float64 zeros."""
        return torch.zeros(tuple(shape), dtype=torch.float64, device=self.torch)

    def put(self, array: NDArray[Any]) -> Tensor:
        """A copy of an array, of the same type."""
        return torch.from_numpy(np.ascontiguousarray(array).copy()).to(self.torch)

    def get(self, tensor: Tensor) -> NDArray[Any]:
        """A copy of a tensor."""
        return np.array(tensor.detach().cpu().numpy())
