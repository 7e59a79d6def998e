"""The page of error codes says what the sources say."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from services import error_page

PAGE = "docs/errors.md"


def rows(source: str) -> list[error_page.Row]:
    return list(error_page.rows_of(ast.parse(source)))


def test_the_page_is_that_of_the_sources(repository: Path, tmp_path: Path) -> None:
    copy = tmp_path / "errors.md"
    error_page.main([str(copy)])
    written = (repository / PAGE).read_text(encoding="utf-8")
    assert copy.read_text(encoding="utf-8") == written, "write it again: python -m services.error_page docs/errors.md"


def test_what_people_meet_first_is_on_it(repository: Path) -> None:
    text = error_page.page(repository)
    for code, status in (
        ("depth_empty", "2 / 422"),
        ("density_missing", "2 / 422"),
        ("mkl_missing", "1 / 503"),
        ("store_unreachable", "1 / 500"),
        ("plm_ref_taken", "- / 409"),
    ):
        assert f"| `{code}` | {status} | " in text, code


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ('raise InputError(f"{a}: no | such file", code="gone")', ("gone", "2 / 422", "…: no \\| such file")),
        ('CODE = "busy"\nraise StoreError("it is in use now", code=CODE)', ("busy", "1 / 500", "it is in use now")),
        ('raise errors.InputError("seven are needed")', ("bad_input", "2 / 422", "seven are needed")),
        ('raise ProblemError(409, "taken", "it is there already")', ("taken", "- / 409", "it is there already")),
        (
            'def f():\n    text = "send it later"\n    raise ProblemError(429, "full", text)\n'
            'def g():\n    text = "or not at all"',
            ("full", "- / 429", "send it later"),
        ),
        (
            'class InferenceBusyError(DrapemeterError):\n    """Too many are waiting."""\n    code = "full"',
            ("full", "- / 503", "Too many are waiting."),
        ),
        ('raise InputError(str(e), code=f"sensor_{name}")', ("sensor_*", "2 / 422", "")),
    ],
)
def test_a_code_with_its_status_and_a_message(source: str, expected: tuple[str, str, str]) -> None:
    (row,) = rows(source)
    assert (row.code, row.status, row.message) == expected


def test_what_is_handed_on_has_no_code_of_its_own() -> None:
    assert rows("raise InputError(str(error), code=error.code)") == []
    assert rows('FieldError(pointer="body", code="invalid", detail="no")') == []
    assert rows('class A:\n    code = "other"\ndef f(code):\n    raise InputError("so it goes", code=code)') == []
