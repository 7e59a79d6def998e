"""Solutions that do not come from a mesh."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import quad, solve_bvp
from scipy.optimize import brentq

Array = NDArray[np.float64]


def nominal_stress(stiffness: float, stretch: float) -> float:
    """Force per width of a strip at this stretch, Saint Venant-Kirchhoff: P = λ k (λ² - 1) / 2 [N/m]."""
    return 0.5 * stiffness * stretch * (stretch**2 - 1.0)


def stretch_under(stiffness: float, force: float) -> float:
    """Inverse of :func:`nominal_stress` in tension."""
    return float(brentq(lambda s: nominal_stress(stiffness, s) - force, 1.0, 3.0, xtol=1e-14))


def hanging_length(stiffness: float, weight_per_area: float, length: float) -> float:
    """Length of a strip of rest length ``length`` under its own weight [m]."""
    return float(quad(lambda s: stretch_under(stiffness, weight_per_area * s), 0.0, length, epsabs=1e-12)[0])


def bias_modulus(warp: float, weft: float, bias: float) -> float:
    """Force per width over strain of a strip cut at 45° that is free to narrow [N/m]."""
    return 4.0 / (1.0 / warp + 1.0 / weft + 1.0 / bias)


def cantilever(rigidity: float, weight_per_area: float, length: float) -> tuple[float, float]:
    """Tip (x, y) of a strip held level at x = 0 that bends under its own weight: B θ'' = w (L - s) cos θ [m]."""

    def slope(s: Array, y: Array) -> Array:
        theta, curvature = y
        return np.stack([curvature, weight_per_area * (length - s) / rigidity * np.cos(theta)])

    def ends(a: Array, b: Array) -> Array:
        return np.array([a[0], b[1]])

    s = np.linspace(0.0, length, 200)
    # θ counts upwards; the weight turns it down. Start from the small-slope answer, cut at a right angle.
    small = -weight_per_area / rigidity * length**3 / 6.0
    guess = np.stack([np.clip(small * np.sin(0.5 * math.pi * s / length), -1.5, 0.0), np.zeros(200)])
    solution = solve_bvp(lambda s, y: slope(s, y), ends, s, guess, tol=1e-8, max_nodes=20000)
    assert solution.success, solution.message
    fine = np.linspace(0.0, length, 4001)
    theta = solution.sol(fine)[0]
    return float(np.trapezoid(np.cos(theta), fine)), float(np.trapezoid(np.sin(theta), fine))


def peirce_bending_length(length: float, drop: float, reach: float) -> float:
    """Peirce (1930): c = L (cos(θ/2) / (8 tan θ))^(1/3), θ the fall of the chord [m]."""
    theta = math.atan2(drop, reach)
    return length * (math.cos(0.5 * theta) / (8.0 * math.tan(theta))) ** (1.0 / 3.0)


def catenary_sag(length: float, span: float) -> float:
    """Sag of an inextensible line of this length between supports at one height [m]."""
    a = brentq(lambda a: 2.0 * a * math.sinh(span / (2.0 * a)) - length, 0.02 * span, 100.0 * span)
    return float(a * (math.cosh(span / (2.0 * a)) - 1.0))
