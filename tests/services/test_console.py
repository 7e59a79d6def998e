"""Plain values for JSON, and progress that stays off pipes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from pydantic import BaseModel

from services import console
from services.plain_json import to_plain
from simcore.scenes import Scene


@dataclass(frozen=True)
class Result:
    scene: Scene
    values: tuple[float, ...]


class Model(BaseModel):
    path: Path


def test_plain_values() -> None:
    value = {
        Scene.HANGING: Result(Scene.STRETCH, (1.0, float("inf"))),
        "array": np.array([[1.5, np.nan]], dtype=np.float32),
        "scalar": np.int64(3),
        "flag": np.bool_(True),
        "model": Model(path=Path("a/b")),
        "none": None,
    }
    assert to_plain(value) == {
        "hanging": {"scene": "stretch", "values": [1.0, None]},
        "array": [[1.5, None]],
        "scalar": 3,
        "flag": True,
        "model": {"path": "a/b"},
        "none": None,
    }
    with pytest.raises(TypeError):
        to_plain(object())


def test_progress_prints_nothing_where_nobody_watches(capsys: pytest.CaptureFixture[str]) -> None:
    with console.progress("working", total=3) as bar:
        bar.advance()
        bar.update(completed=3)
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err == ""


def test_an_error_is_one_line_whatever_its_message(capsys: pytest.CaptureFixture[str]) -> None:
    console.error_line("first\n  second", "some_code")
    assert capsys.readouterr().err == "error: first second [some_code]\n"


def test_names_cannot_steer_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    console.say("cotton\x1b[2J\u202egnp: 0.2 kg/m²\n\tas it is")
    console.note("a\rb\x9b")
    said = capsys.readouterr()
    assert said.out == "cotton\\x1b[2J\\u202egnp: 0.2 kg/m²\n\tas it is\n"
    assert said.err == "a\\rb\\x9b\n"
