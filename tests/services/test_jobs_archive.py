"""Capture sets as ZIP archives: what is taken, and what never leaves the folder or fills the disk."""

from __future__ import annotations

import io
import stat
import zipfile
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.jobs.archive import ArchiveLimits, beginnings, names_in, read_captures_json, unpack
from simcore.errors import InputError

LIMITS = ArchiveLimits(most_bytes=100_000)
Entries = list[tuple[str | zipfile.ZipInfo, bytes]]


def archive(entries: Entries) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as writer:
        for name, content in entries:
            writer.writestr(name, content)
    return stream.getvalue()


def code_of(content: bytes, folder: Path) -> str:
    with pytest.raises(InputError) as caught:
        unpack(content, folder, LIMITS)
    return caught.value.code


@pytest.mark.parametrize("prefix", ["", "my captures/"])
def test_a_set_is_unpacked_from_the_top_or_from_one_folder(prefix: str, tmp_path: Path) -> None:
    content = archive(
        [
            (f"{prefix}captures.json", b"{}"),
            (f"{prefix}pictures/a.png", b"a"),
            (f"{prefix}notes.exe", b"left out"),
            (f"__MACOSX/{prefix}._a.png", b"left out from beside a folder"),
        ]
    )
    unpack(content, tmp_path, LIMITS)
    found = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*") if path.is_file()}
    assert {"captures.json", "pictures/a.png"} <= found
    assert not any(name.endswith(".exe") for name in found)
    assert read_captures_json(content, LIMITS) == "{}"
    assert {"captures.json", "pictures/a.png"} <= names_in(content, LIMITS)


def test_a_picture_of_any_name_is_unpacked_if_it_is_named(tmp_path: Path) -> None:
    content = archive([("captures.json", b"\xef\xbb\xbf{}"), ("picture", b"a"), ("f1:a.png", b"b"), ("other", b"c")])
    unpack(content, tmp_path, LIMITS, ["picture"])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["captures.json", "f1:a.png", "picture"]
    assert read_captures_json(content, LIMITS) == "{}"


@pytest.mark.parametrize("name", ["Köper_Größe-hanging-0.png", "絹-stretch-1.png"])
def test_names_in_utf8_that_do_not_say_so_are_read_as_such(name: str, tmp_path: Path) -> None:
    """As Debian's `zip` writes them; others say which they are."""
    said = archive([("captures.json", b"{}"), (name, b"a")])
    unsaid = bytearray(said)
    for mark, flags in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        at = unsaid.find(mark)
        while at >= 0:
            unsaid[at + flags + 1] &= ~0x08 & 0xFF
            at = unsaid.find(mark, at + 1)
    for number, content in enumerate((said, bytes(unsaid))):
        assert name in names_in(content, LIMITS)
        (tmp_path / str(number)).mkdir()
        unpack(content, tmp_path / str(number), LIMITS)
        assert (tmp_path / str(number) / name).read_bytes() == b"a"


def link(name: str) -> zipfile.ZipInfo:
    info = zipfile.ZipInfo(name)
    info.external_attr = (stat.S_IFLNK | 0o777) << 16
    return info


@pytest.mark.parametrize(
    ("entries", "code"),
    [
        ([("../captures.json", b"{}")], "archive_unsafe"),
        ([("/captures.json", b"{}")], "archive_unsafe"),
        ([("captures.json", b"{}"), ("C:\\a.png", b"")], "archive_unsafe"),
        ([("captures.json", b"{}"), ("a/../../b.png", b"")], "archive_unsafe"),
        ([("captures.json", b"{}"), (link("a.png"), b"/etc/passwd")], "archive_unsafe"),
        ([("a.png", b"")], "captures_json_missing"),
        ([("a/captures.json", b"{}"), ("b/captures.json", b"{}")], "captures_json_missing"),
        ([("a/b/captures.json", b"{}")], "captures_json_missing"),
        ([("captures.json", b"{}"), ("a.png", bytes(200_000))], "archive_too_large"),
        ([("captures.json", b"{}"), *((f"{n}.png", b"") for n in range(5000))], "archive_too_large"),
    ],
)
def test_what_is_not_safe_is_refused_and_leaves_nothing(entries: Entries, code: str, tmp_path: Path) -> None:
    folder = tmp_path / "in" / "here"
    folder.mkdir(parents=True)
    assert code_of(archive(entries), folder) == code
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_two_entries_of_one_name_are_refused(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match="Duplicate"):
        content = archive([("captures.json", b"{}"), ("captures.json", b"[]")])
    assert code_of(content, tmp_path) in {"archive_unsafe", "captures_json_missing"}


def test_an_entry_that_lies_about_its_size_is_not_believed(tmp_path: Path) -> None:
    content = bytearray(archive([("captures.json", b"{}"), ("a.png", bytes(300_000))]))
    directory = content.rindex(b"PK\x01\x02")
    content[directory + 24 : directory + 28] = (10).to_bytes(4, "little")  # its uncompressed size
    assert code_of(bytes(content), tmp_path) in {"archive_damaged", "archive_too_large"}
    assert sum(path.stat().st_size for path in tmp_path.rglob("*.png")) <= LIMITS.most_bytes


@pytest.mark.parametrize("force_64", [False, True])
def test_a_huge_table_of_contents_is_refused_before_it_is_read(force_64: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as writer:
        for number in range(40_000):
            writer.writestr(f"{number}", b"")
        if force_64:
            monkeypatch.setattr(zipfile, "ZIP_FILECOUNT_LIMIT", 10)
    content = stream.getvalue()
    assert (b"PK\6\6" in content) is force_64
    monkeypatch.setattr(zipfile.ZipFile, "_RealGetContents", lambda self: pytest.fail("it was read"))
    for one in (content, b"before it" + content):
        with pytest.raises(InputError, match="at most 5000") as caught:
            names_in(one, LIMITS)
        assert caught.value.code == "archive_too_large"


def test_an_encrypted_entry_is_refused(tmp_path: Path) -> None:
    content = bytearray(archive([("captures.json", b"{}")]))
    content[content.index(b"PK\x01\x02") + 8] |= 1  # the flag in the table of contents
    assert code_of(bytes(content), tmp_path) == "archive_encrypted"


@settings(max_examples=300, deadline=None)
@given(cut=st.integers(0, 400), flip=st.integers(0, 400), value=st.integers(0, 255))
def test_damage_is_an_input_error_or_harmless(cut: int, flip: int, value: int) -> None:
    whole = bytearray(archive([("captures.json", b'{"a": 1}' * 9), ("a.png", b"b" * 99)]))
    whole[flip % len(whole)] = value
    for content in (bytes(whole), bytes(whole)[: cut % len(whole)]):
        try:
            read_captures_json(content, LIMITS)
            names_in(content, LIMITS)
        except InputError as error:
            assert error.code.startswith(("archive_", "captures_json", "file_"))


@pytest.mark.parametrize(
    "entries",
    [
        [("captures.json", b"{}"), ("a.png", b"a"), ("a.png/b.png", b"b")],
        [("captures.json", b"{}"), ("\u00e4" * 120 + ".png", b"a")],
        [("captures.json", b"{}"), ("a/" * 1500 + "b.png", b"a")],
        [("captures.json", b"{}"), (("a" * 150 + "/") * 31 + "b.png", b"a")],
    ],
)
def test_names_that_no_folder_can_hold_are_refused_before_a_job_is_made(entries: Entries) -> None:
    for look in (read_captures_json, names_in):
        with pytest.raises(InputError) as caught:
            look(archive(entries), LIMITS)
        assert caught.value.code == "archive_unsafe"


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_what_unpacks_all_at_once_is_refused_before_it_is_opened(method: int, tmp_path: Path) -> None:
    """40 bytes of bzip2 are 46 MB of zeros, and are unpacked in one go."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", method) as writer:
        writer.writestr("captures.json", bytes(50_000))
    assert code_of(stream.getvalue(), tmp_path) == "archive_method"


def test_the_beginning_of_a_file_is_read_without_the_rest() -> None:
    content = archive([("set/captures.json", b"{}"), ("set/a.png", b"abcdef"), ("set/b.png", b"x")])
    assert beginnings(content, LIMITS, ["a.png"], 3) == {"a.png": b"abc"}
