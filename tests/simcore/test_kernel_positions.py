"""What Taichi tells of an error in a kernel, and that other versions of it are left alone."""

from __future__ import annotations

import pytest
from taichi.lang.ast import ast_transformer_utils

from simcore.kernel_positions import tell_positions_short
from simcore.lang import start, ti


def test_an_error_in_a_kernel_is_told_with_file_line_and_text() -> None:
    start()

    @ti.kernel
    def wrong():  # type: ignore[no-untyped-def]
        for i in range(3):
            print(i + nowhere)  # type: ignore[name-defined]  # noqa: F821

    with pytest.raises(ti.TaichiNameError, match=r'"nowhere" is not defined') as caught:
        wrong()
    assert f'File "{__file__}", line ' in str(caught.value) and "in wrong" in str(caught.value)
    assert "print(i + nowhere)" in str(caught.value)


def test_another_taichi_is_left_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    class Other:
        pass

    monkeypatch.setattr(ast_transformer_utils, "ASTTransformerContext", Other)
    tell_positions_short()
    assert vars(Other).keys() == vars(type("Plain", (), {})).keys()
