"""Sparse factorisations: inertia, solutions, and what remains usable after a matrix that is not positive."""

from __future__ import annotations

from importlib import metadata

import numpy as np
import pytest

from simcore.errors import MissingResourceError
from simcore.grid import Grid
from simcore.pardiso import Factorisation, _library

PATTERN = Grid(7, 9, 0.01, 0.01).pattern
INDPTR, INDICES = PATTERN.indptr, PATTERN.indices
N = len(INDPTR) - 1


def symmetric(diagonal: np.ndarray, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Values of the pattern's upper triangle, and the whole matrix: small couplings beside the diagonal."""
    values = 0.02 * np.random.default_rng(seed).standard_normal(len(INDICES))
    values[INDPTR[:-1]] = diagonal
    whole = np.zeros((N, N))
    whole[np.repeat(np.arange(N), np.diff(INDPTR)), INDICES] = values
    return values, np.triu(whole) + np.triu(whole, 1).T


@pytest.mark.parametrize("single", [False, True])
def test_solutions_are_numpys(single: bool) -> None:
    values, whole = symmetric(np.linspace(1.0, 3.0, N))
    factorisation = Factorisation(INDPTR, INDICES, single)
    assert factorisation.factor(values) == 0
    right = 1e-9 * np.random.default_rng(1).standard_normal((3, N))  # forces near rest are that small
    expected = np.linalg.solve(whole, right.T).T
    for found, wanted in [(factorisation.solve(right), expected), (factorisation.solve(right[1]), expected[1])]:
        assert np.abs(found - wanted).max() < (1e-5 if single else 1e-12) * np.abs(expected).max()


def test_double_precision_counts_negative_eigenvalues() -> None:
    diagonal = np.linspace(1.0, 3.0, N)
    diagonal[[5, 50, 100]] *= -1.0
    values, whole = symmetric(diagonal)
    assert (np.linalg.eigvalsh(whole) < 0.0).sum() == 3
    assert Factorisation(INDPTR, INDICES).factor(values) == 3


@pytest.mark.parametrize("single", [False, True])
def test_a_matrix_that_is_not_positive_is_told_and_leaves_nothing_behind(single: bool) -> None:
    diagonal = np.linspace(1.0, 3.0, N)
    good, whole = symmetric(diagonal)
    diagonal[N // 2] = -0.5
    factorisation = Factorisation(INDPTR, INDICES, single)
    assert factorisation.factor(symmetric(diagonal)[0]) > 0
    assert factorisation.factor(good) == 0
    right = np.ones(N)
    assert factorisation.solve(right) == pytest.approx(np.linalg.solve(whole, right), rel=1e-4)


def test_without_mkl_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(name: str) -> None:
        raise metadata.PackageNotFoundError(name)

    for files in (absent, lambda name: None, lambda name: []):
        monkeypatch.setattr(metadata, "files", files)
        with pytest.raises(MissingResourceError, match="oneMKL is not installed: pip install mkl") as caught:
            _library.__wrapped__()  # what was found before is kept
        assert caught.value.code == "mkl_missing"


def test_memory_given_back_comes_again() -> None:
    values, whole = symmetric(np.full(N, 2.0))
    factorisation = Factorisation(INDPTR, INDICES)
    factorisation.forget()
    for _ in range(2):
        assert factorisation.factor(values) == 0
        assert factorisation.solve(np.ones(N)) == pytest.approx(np.linalg.solve(whole, np.ones(N)), rel=1e-10)
        factorisation.forget()
