"""Folders of processes that were killed are cleared, those of the living never, whatever their numbers."""

from __future__ import annotations

import multiprocessing
import os
import tempfile
from multiprocessing.connection import Connection
from pathlib import Path

import pytest

from services.jobs import scratch
from services.jobs.scratch import clear_abandoned, make_scratch, remove_scratch, scratch_folder


@pytest.fixture(autouse=True)
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def hold(connection: Connection, place: str) -> None:
    """A process that has a folder until it is killed."""
    tempfile.tempdir = place
    connection.send(make_scratch())
    connection.recv()


def test_where_no_folder_can_be_written_to_there_is_nothing_to_clear(monkeypatch: pytest.MonkeyPatch) -> None:
    """A worker that starts on a full disk gets as far as its jobs, which say so."""

    def full() -> str:
        raise FileNotFoundError(2, "No usable temporary directory found in ['/tmp']")

    monkeypatch.setattr(tempfile, "gettempdir", full)
    assert clear_abandoned() == 0


def test_a_folder_is_cleared_once_its_process_is_gone(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    spawn = multiprocessing.get_context("spawn")
    ours, theirs = spawn.Pipe()
    process = spawn.Process(target=hold, args=(theirs, str(place)))
    process.start()
    folder = ours.recv()
    (folder / "a.png").touch()
    assert clear_abandoned() == 0 and (folder / "a.png").exists()
    process.kill()
    process.join()
    monkeypatch.setattr(os, "kill", lambda pid, number: None)  # as if another had its number, as in a container
    assert clear_abandoned() == 1 and not folder.exists()
    process.close()


def test_ones_own_folders_are_held_until_they_are_removed(place: Path) -> None:
    kept = make_scratch()
    with scratch_folder() as brief:
        assert clear_abandoned() == 0 and kept.is_dir() and brief.is_dir()
    assert not brief.exists()
    remove_scratch(kept)
    assert list(place.iterdir()) == [] and not scratch._held


def test_a_folder_that_another_clears_before_it_is_held_is_made_again(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, made = tempfile.mkdtemp, []

    def make(prefix: str) -> str:
        made.append(whole(prefix=prefix))
        if len(made) == 1:
            assert clear_abandoned() == 1
        return made[-1]

    monkeypatch.setattr(tempfile, "mkdtemp", make)
    folder = make_scratch()
    assert [folder] == [Path(made[1])] == list(place.iterdir())
    remove_scratch(folder)


def test_a_place_without_locks_is_worked_in_and_never_cleared(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(handle: int, operation: int) -> None:
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr("fcntl.flock", refuse)
    folder = make_scratch()
    assert clear_abandoned() == 0 and folder.is_dir()
    remove_scratch(folder)
    assert not folder.exists()
