"""Where compiled kernels are kept: compiled code that is run, so no other user may have put it there."""

from __future__ import annotations

from pathlib import Path

import pytest

from simcore.errors import MissingResourceError
from simcore.lang import _cache_folder, _claim, _own_folder


def test_a_folder_of_ones_own_is_taken_and_closed_to_others(tmp_path: Path) -> None:
    wanted = tmp_path / "drapemeter-1"
    assert _own_folder(wanted) == wanted == _own_folder(wanted)
    wanted.chmod(0o777)
    assert _own_folder(wanted).stat().st_mode & 0o777 == 0o700


def test_what_another_has_laid_there_is_not_taken(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    link, file = tmp_path / "link", tmp_path / "file"
    link.symlink_to(tmp_path / "elsewhere")
    file.touch()
    for wanted in (link, file):
        found = _own_folder(wanted)
        assert found != wanted and found.parent == tmp_path and found.stat().st_mode & 0o077 == 0
    assert not list((tmp_path / "elsewhere").iterdir())


def test_each_claim_is_another_folder_and_those_of_others_are_passed_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = _claim(tmp_path), _claim(tmp_path)
    assert {first, second} == {tmp_path / "0" / "cache", tmp_path / "1" / "cache"}

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError

    monkeypatch.setattr(Path, "mkdir", refuse)
    with pytest.raises(MissingResourceError, match="DRAPEMETER_KERNEL_CACHE to a folder of your own") as caught:
        _claim(tmp_path)
    assert caught.value.code == "kernel_cache"


def test_processes_side_by_side_have_folders_of_their_own_wherever_they_are_told_to_keep_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DRAPEMETER_KERNEL_CACHE", str(tmp_path / "named"))
    assert [_cache_folder(), _cache_folder()] == [tmp_path / "named" / n / "cache" for n in "01"]
    monkeypatch.delenv("DRAPEMETER_KERNEL_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert _cache_folder() == tmp_path / "drapemeter" / "kernels" / "0" / "cache"


def test_a_place_that_can_hold_no_folder_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(MissingResourceError, match="DRAPEMETER_KERNEL_CACHE") as caught:
        _claim(tmp_path / "file")
    assert caught.value.code == "kernel_cache"
