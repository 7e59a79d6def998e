"""Inner products that do not depend on the machine."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def inner(a: Array, b: Array) -> float:
    """Sum of the products of two arrays of one shape.

    A BLAS library shares such a sum out among the machine's cores, which changes its last bits with their number and,
    at these sizes, costs a hundred times the sum itself when they are busy; einsum stays on one.
    """
    return float(np.einsum("i,i->", a.ravel(), b.ravel()))


def norm(a: Array) -> float:
    """Square root of the sum of squares."""
    return math.sqrt(inner(a, a))
