"""Capture sets as ZIP archives: checked and unpacked without trusting what they say of themselves."""

from __future__ import annotations

import io
import re
import stat
import struct
import zipfile
import zlib
from collections.abc import Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from simcore.errors import InputError

CAPTURES_FILE = "captures.json"
MOST_ENTRIES = 5000
UTF8_FLAG = 0x800
MOST_CONTENTS_BYTES = 320 * MOST_ENTRIES
END_RECORD, END_BYTES = b"PK\5\6", 22
END_RECORD_64, END_BYTES_64, END_LOCATOR_64 = b"PK\6\6", 56, b"PK\6\7"
MOST_JSON_BYTES = 8 * 1024 * 1024
SUFFIXES = frozenset({".json", ".png"})
MOST_NAME_BYTES = 200
MOST_PATH_BYTES, MOST_PARTS = 1000, 50
DRIVE = re.compile(r"[A-Za-z]:")
BLOCK = 256 * 1024
METHODS = frozenset({zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED})
"""Of these as little is unpacked at once as is asked for; of bzip2 and LZMA all that a few bytes hold."""
DAMAGE = (
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    EOFError,
    NotImplementedError,
    OSError,
    ValueError,
    RuntimeError,
)
"""What :mod:`zipfile` raises on archives that are not whole, or of kinds that it does not read."""


@dataclass(frozen=True)
class ArchiveLimits:
    """How much an archive may hold, unpacked."""

    most_bytes: int


@dataclass(frozen=True)
class _Entry:
    info: zipfile.ZipInfo
    name: str


def read_captures_json(content: bytes, limits: ArchiveLimits) -> str:
    """Check an archive's table of contents and return its ``captures.json``.

    Raises:
        InputError: no usable archive; see :func:`unpack`.
    """
    with _open(content) as archive:
        entries = _entries(archive, limits)
        entry = next(e for e in entries if e.name == CAPTURES_FILE)
        data = b"".join(_blocks(archive, entry, MOST_JSON_BYTES))
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{CAPTURES_FILE} in the archive is not UTF-8 text", code="file_unreadable") from None


def beginnings(content: bytes, limits: ArchiveLimits, names: Collection[str], count: int) -> dict[str, bytes]:
    """The first ``count`` bytes of some files in an archive, by names relative to the folder of ``captures.json``.

    Raises:
        InputError: no usable archive; see :func:`unpack`.
    """
    found = {}
    with _open(content) as archive:
        for entry in _entries(archive, limits):
            if entry.name in names:
                try:
                    with archive.open(entry.info) as stream:
                        found[entry.name] = stream.read(count)
                except DAMAGE as error:
                    raise _damaged(entry, error) from None
    return found


def names_in(content: bytes, limits: ArchiveLimits) -> frozenset[str]:
    """Names of the files in an archive, relative to the folder of ``captures.json``.

    Raises:
        InputError: no usable archive; see :func:`unpack`.
    """
    with _open(content) as archive:
        return frozenset(entry.name for entry in _entries(archive, limits))


def unpack(content: bytes, folder: Path, limits: ArchiveLimits, named: Collection[str] = ()) -> None:
    """Unpack ``captures.json``, the PNG files beside it and what it names; they may lie in one folder of the archive.

    Nothing is written outside ``folder``, and never more than the limits, whatever the archive says of itself.

    Args:
        content: the archive.
        folder: exists and is empty.
        limits: how much it may hold.
        named: pictures that are no ``*.png``, by names relative to the folder of ``captures.json``.

    Raises:
        InputError: no ZIP or a damaged one, encrypted or linked entries, paths that lead out, or too much.
    """
    with _open(content) as archive:
        room = limits.most_bytes
        wanted = set(named)
        for entry in _entries(archive, limits):
            if PurePosixPath(entry.name).suffix.lower() not in SUFFIXES and entry.name not in wanted:
                continue
            target = folder.joinpath(*PurePosixPath(entry.name).parts)
            target.parent.mkdir(parents=True, exist_ok=True)
            with target.open("xb") as stream:
                for block in _blocks(archive, entry, room):
                    room -= len(block)
                    stream.write(block)


def _open(content: bytes) -> zipfile.ZipFile:
    if _contents_bytes(content) > MOST_CONTENTS_BYTES:  # read whole, into an object an entry, before anything is known
        raise InputError(f"the archive has too many files: at most {MOST_ENTRIES} are taken", code="archive_too_large")
    try:
        return zipfile.ZipFile(io.BytesIO(content))
    except DAMAGE:
        raise InputError(
            "the capture set is not a ZIP archive: send captures.json and its PNG files as one ZIP",
            code="archive_not_zip",
        ) from None


def _contents_bytes(content: bytes) -> int:
    """Length of an archive's table of contents, as its end record says, which :mod:`zipfile` goes by."""
    at = content.rfind(END_RECORD, max(0, len(content) - END_BYTES - 0xFFFF))
    if at < 0 or at + END_BYTES > len(content):
        return 0  # no archive: told when it is opened
    size = int(struct.unpack_from("<L", content, at + 12)[0])
    locator = content.rfind(END_LOCATOR_64, max(0, at - 20), at)
    if locator >= 0:
        (end,) = struct.unpack_from("<Q", content, locator + 8)
        for place in (end, locator - END_BYTES_64):  # an archive behind other bytes says its own offsets
            if 0 <= place <= len(content) - END_BYTES_64 and content.startswith(END_RECORD_64, place):
                size = max(size if size != 0xFFFFFFFF else 0, int(struct.unpack_from("<Q", content, place + 40)[0]))
    return size


def _entries(archive: zipfile.ZipFile, limits: ArchiveLimits) -> list[_Entry]:
    infos = [info for info in archive.infolist() if not info.filename.endswith("/")]
    for info in infos:
        info.filename = _as_written(info)
    if len(infos) > MOST_ENTRIES:
        raise InputError(
            f"the archive has {len(infos)} files: at most {MOST_ENTRIES} are taken", code="archive_too_large"
        )
    for info in infos:
        _refuse_unsafe(info)
    if sum(info.file_size for info in infos) > limits.most_bytes:
        raise _too_large(limits.most_bytes)
    root = _root(infos)
    entries = [
        _Entry(info, PurePosixPath(info.filename).relative_to(root).as_posix())
        for info in infos
        if PurePosixPath(info.filename).is_relative_to(root)
    ]
    if len({entry.name for entry in entries}) != len(entries):
        raise InputError("the archive has two files of the same name", code="archive_unsafe")
    folders = {parent.as_posix() for entry in entries for parent in PurePosixPath(entry.name).parents}
    if any(entry.name in folders for entry in entries):
        raise InputError("the archive has a file and a folder of the same name", code="archive_unsafe")
    return entries


def _as_written(info: zipfile.ZipInfo) -> str:
    """A file's name: `zip` of Debian and others write UTF-8 without saying so, and it is read as an old code page."""
    if info.flag_bits & UTF8_FLAG:
        return info.filename
    with suppress(UnicodeError):
        return info.filename.encode("cp437").decode("utf-8")
    return info.filename


def _refuse_unsafe(info: zipfile.ZipInfo) -> None:
    path = PurePosixPath(info.filename)
    kind = stat.S_IFMT(info.external_attr >> 16)
    unsafe = path.is_absolute() or ".." in path.parts or "\\" in info.filename or DRIVE.match(info.filename)
    if unsafe or "\0" in info.orig_filename or kind not in {0, stat.S_IFREG} or not path.parts:
        raise InputError("the archive holds a link or a path that leads out of it", code="archive_unsafe")
    if any(len(part.encode("utf-8", "replace")) > MOST_NAME_BYTES for part in path.parts):
        raise InputError(f"a name in the archive is longer than {MOST_NAME_BYTES} bytes", code="archive_unsafe")
    if len(info.filename.encode("utf-8", "replace")) > MOST_PATH_BYTES or len(path.parts) > MOST_PARTS:
        raise InputError(
            f"a path in the archive is longer than {MOST_PATH_BYTES} bytes or {MOST_PARTS} names: shorten it",
            code="archive_unsafe",
        )
    if info.compress_type not in METHODS:
        raise InputError(
            f"{info.filename} in the archive is packed in a way that is not taken: store or deflate it, as `zip` does",
            code="archive_method",
        )
    if info.flag_bits & 0x1:
        raise InputError("the archive is encrypted: send it without a password", code="archive_encrypted")


def _root(infos: list[zipfile.ZipInfo]) -> PurePosixPath:
    """Folder of the only ``captures.json``, at most one deep."""
    found = [
        PurePosixPath(info.filename).parent for info in infos if PurePosixPath(info.filename).name == CAPTURES_FILE
    ]
    shallow = [folder for folder in found if len(folder.parts) <= 1]
    if len(shallow) != 1:
        raise InputError(
            f"the archive needs exactly one {CAPTURES_FILE}, at its top or in one folder", code="captures_json_missing"
        )
    return shallow[0]


def _blocks(archive: zipfile.ZipFile, entry: _Entry, room: int) -> Iterator[bytes]:
    """Content of an entry, a little at a time; its stated size is not believed."""
    size = 0
    try:
        with archive.open(entry.info) as stream:
            while block := stream.read(BLOCK):
                size += len(block)
                if size > room:
                    raise _too_large(room)
                yield block
    except DAMAGE as error:
        raise _damaged(entry, error) from None


def _damaged(entry: _Entry, error: Exception) -> InputError:
    return InputError(f"{entry.name} in the archive is damaged ({error})", code="archive_damaged")


def _too_large(limit: int) -> InputError:
    return InputError(f"the archive unpacks to more than {limit} bytes: send fewer captures", code="archive_too_large")
