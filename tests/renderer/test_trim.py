"""Folders of what can be made again stay below a size; what was used last stays."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from renderer.trim import mark_used, trim_folder


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Five files of 100 bytes, the first the oldest, one in a folder of its own, and one of another kind."""
    (tmp_path / "ab").mkdir()
    for number, place in enumerate(["0.npz", "ab/1.npz", "2.npz", "3.npz", "4.npz"]):
        (tmp_path / place).write_bytes(bytes(100))
        os.utime(tmp_path / place, (1000 + number, 1000 + number))
    (tmp_path / "notes.json").write_bytes(bytes(1000))
    return tmp_path


def left(folder: Path) -> set[str]:
    return {path.name for path in folder.rglob("*") if path.is_file()}


def test_the_oldest_go_first(folder: Path) -> None:
    assert trim_folder(folder, 250, ".npz") == 3
    assert left(folder) == {"3.npz", "4.npz", "notes.json"}


def test_what_fits_stays(folder: Path) -> None:
    assert trim_folder(folder, 500, ".npz") == 0
    assert len(left(folder)) == 6
    assert trim_folder(folder / "absent", 0, ".npz") == 0


def test_what_was_used_stays(folder: Path) -> None:
    mark_used(folder / "0.npz")
    mark_used(folder / "gone.npz")  # removed by another process meanwhile: nothing to note
    trim_folder(folder, 200, ".npz")
    assert left(folder) == {"0.npz", "4.npz", "notes.json"}
