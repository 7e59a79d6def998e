"""Sparse factorisations: inertia, solutions, and what remains usable after a matrix that is not positive."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simcore import pardiso
from simcore.errors import MissingResourceError, OutOfMemoryError, SimulationError
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


class Failing:
    """oneMKL whose PARDISO fails in one phase."""

    def __init__(self, phase: int, error: int) -> None:
        self._phase, self._error, self._real = phase, error, _library()

    def pardiso(self, *arguments: Any) -> None:
        """As PARDISO; the phase is the fifth argument, the error the last."""
        if arguments[4]._obj.value == self._phase:
            arguments[-1]._obj.value = self._error
        else:
            self._real.pardiso(*arguments)


@pytest.mark.parametrize("single", [False, True])
@pytest.mark.parametrize("phase", [11, 22, 33])
@pytest.mark.parametrize(("error", "words"), [(-2, "out of memory: .* coarser cells"), (-3, "ordered"), (-5, "inside")])
def test_what_fails_is_said(single: bool, phase: int, error: int, words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    failing = Failing(phase, error)
    monkeypatch.setattr(pardiso, "_library", lambda: failing)
    values, _ = symmetric(np.full(N, 2.0))
    with pytest.raises(SimulationError, match=words) as caught:
        factorisation = Factorisation(INDPTR, INDICES, single)
        assert factorisation.factor(values) == 0
        factorisation.solve(np.ones(N))
    assert caught.value.code == "factorisation_failed"
    assert isinstance(caught.value, OutOfMemoryError) == (error == -2)


@pytest.mark.parametrize("single", [False, True])
def test_a_pivot_of_zero_is_no_failure(single: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    failing = Failing(22, -4)
    monkeypatch.setattr(pardiso, "_library", lambda: failing)
    assert Factorisation(INDPTR, INDICES, single).factor(symmetric(np.full(N, 2.0))[0]) == N


PROGRAM = """
import resource, sys
from pathlib import Path
import numpy as np
from simcore.grid import Grid
from simcore.pardiso import Factorisation
pattern = Grid(61, 61, 0.01, 0.01).pattern
values = 0.02 * np.random.default_rng(0).standard_normal(len(pattern.indices))
values[pattern.indptr[:-1]] = 3.0
if len(sys.argv) > 1:
    small = Grid(5, 5, 0.01, 0.01).pattern
    Factorisation(small.indptr, small.indices).factor(np.ones(len(small.indices)))  # the library is loaded whole
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + int(sys.argv[1]), used + int(sys.argv[1])))
factorisation = Factorisation(pattern.indptr, pattern.indices)
print(factorisation.factor(values), factorisation.solve(np.ones(factorisation.n)).tobytes().hex())
"""


def run(repository: Path, *arguments: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """The program above in a process of its own."""
    own = {name: value for name, value in os.environ.items() if not name.startswith("MKL_")}
    return subprocess.run(
        [sys.executable, "-c", PROGRAM, *arguments],
        env=own | variables, cwd=str(repository), capture_output=True, text=True, check=False,
    )  # fmt: skip


@pytest.mark.parametrize("layer", ["GNU", "INTEL"])
def test_the_same_bits_whatever_layer_of_threads_the_environment_names(layer: str, repository: Path) -> None:
    plain, named = run(repository), run(repository, MKL_THREADING_LAYER=layer, MKL_NUM_THREADS="2")
    assert plain.returncode == named.returncode == 0, named.stderr
    assert plain.stdout.startswith("0 ") and plain.stdout == named.stdout


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_too_little_memory_is_said(repository: Path) -> None:
    done = run(repository, str(8 << 20))
    assert done.returncode == 1 and "OutOfMemoryError: out of memory: 11163 equations" in done.stderr, done.stderr
