"""Kernels launched again and again with arrays that change."""

import numpy as np
import pytest

from simcore import lang
from simcore.lang import ti
from simcore.launch import Launch

lang.start()

vectors1 = ti.types.ndarray(dtype=ti.types.vector(3, ti.f64), ndim=1)
numbers1 = ti.types.ndarray(dtype=ti.f64, ndim=1)


@ti.kernel
def lengths(x: vectors1, out: numbers1):
    for i in range(x.shape[0]):
        out[i] = x[i].norm()


def test_the_same_as_the_kernels_own_call_whatever_arrays_come() -> None:
    launch = Launch(lengths)
    rng = np.random.default_rng(0)
    for count in (4, 4, 9, 2):  # other arrays, other lengths
        x = rng.standard_normal((count, 3))
        out, own = np.zeros(count), np.zeros(count)
        launch(x, out)
        lengths(x, own)
        assert out.tobytes() == own.tobytes()
        x *= 2.0  # changed in place
        launch(x, out)
        assert out == pytest.approx(2.0 * own)


def test_an_array_that_it_launched_with_may_be_gone() -> None:
    launch = Launch(lengths)
    out = np.zeros(1000)
    for scale in range(20):
        launch(np.full((1000, 3), float(scale)), out)  # the next array is often put where this one was
        assert out == pytest.approx(np.sqrt(3.0) * scale)


def test_arrays_of_another_kind_are_refused() -> None:
    launch = Launch(lengths)
    launch(np.zeros((4, 3)), np.zeros(4))
    with pytest.raises(TypeError, match="argument 0"):
        launch(np.zeros((4, 3), dtype=np.float32), np.zeros(4))
    with pytest.raises(TypeError, match="argument 0"):
        launch(np.zeros((3, 4)).T, np.zeros(4))


def test_without_the_known_inner_calls_the_kernel_is_called(monkeypatch: pytest.MonkeyPatch) -> None:
    called = []

    def other(*arrays: object) -> None:
        called.append(len(arrays))

    Launch(other)(np.zeros((4, 3)), np.zeros(4))
    monkeypatch.setattr("simcore.launch.on_cpu", lambda: False)
    Launch(other)(np.zeros((4, 3)), np.zeros(4))
    assert called == [2, 2]
