"""Where a store lies: a local folder, ``s3://`` or any other URL that obstore takes; and its failures as our errors."""

from __future__ import annotations

import errno
import os
import re
import shutil
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import timedelta
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from renderer.atomic import NO_ROOM
from renderer.store_format import SCHEMA
from simcore.errors import DrapemeterError, InputError, StoreError

if TYPE_CHECKING:
    from zarr.abc.store import Store as ZarrStore

_NOT_ALLOWED = (errno.EACCES, errno.EPERM, errno.EROFS)
ATTRIBUTES: Mapping[str, type] = MappingProxyType(
    {"configuration": Mapping, "layout": Mapping, "seed": int, "software_version": str}
)
"""What every store states of itself."""


def is_remote(url: str | Path) -> bool:
    """Whether the place is an object store rather than a local folder.

    Raises:
        InputError: ``file:`` in another form than ``file:///folder``, or ``memory:``, which no other process sees.
    """
    text = str(url)
    if text.startswith("memory:") or (text.startswith("file:") and not text.startswith("file:///")):
        raise InputError(f"{url}: not a place for a store: name a folder, file:///folder or s3://...", code="store_url")
    if re.match(r"[A-Za-z][A-Za-z0-9+.-]+:/(?!/)", text):
        raise InputError(f"{url}: not a place for a store: write {text.replace(':/', '://', 1)}", code="store_url")
    return "://" in text and not text.startswith("file://")


def local_path(url: str | Path) -> Path:
    """Folder of a local store."""
    return Path(str(url).removeprefix("file://"))


def remove_store(url: str | Path) -> None:
    """Remove everything at a place, as far as it can be."""
    if not is_remote(url):
        shutil.rmtree(local_path(url), ignore_errors=True)
        return
    import obstore

    with suppress(OSError, obstore.exceptions.BaseError):
        place = object_store(url)
        for batch in obstore.list(place):
            obstore.delete(place, [entry["path"] for entry in batch])


def listed_sizes(url: str | Path) -> Iterator[tuple[str, int]]:
    """Every object below a place with its size [byte], by listing alone."""
    if is_remote(url):
        import obstore

        for batch in obstore.list(object_store(url)):
            yield from ((entry["path"], entry["size"]) for entry in batch)
        return
    root = local_path(url)
    for path in root.rglob("*"):
        if path.is_file():
            yield path.relative_to(root).as_posix(), path.stat().st_size


def open_location(url: str | Path, *, read_only: bool) -> ZarrStore:
    """The Zarr storage at a place; nothing is read or written yet.

    Raises:
        InputError: a URL that obstore does not know, or unusable settings.
    """
    from zarr.storage import LocalStore

    if not is_remote(url):
        return LocalStore(local_path(url), read_only=read_only)
    from renderer.store_remote import PatientObjectStore

    return PatientObjectStore(object_store(url), read_only=read_only)


def object_store(url: str | Path) -> Any:
    """obstore's store at a URL; nothing is asked of it yet.

    Object stores take their credentials and endpoint from the environment, as obstore does (``AWS_ACCESS_KEY_ID``,
    ``AWS_ENDPOINT_URL``, ...). Requests that fail for a passing reason are repeated for up to two minutes
    (``DRAPEMETER_STORE_RETRY_S``).

    Raises:
        InputError: a URL that obstore does not know, or unusable settings (``DRAPEMETER_STORE_RETRY_S`` among them).
    """
    import obstore.exceptions
    from obstore.store import from_url

    from renderer.store_remote import patience_s

    patience = timedelta(seconds=patience_s())
    options: Any = {"timeout": timedelta(seconds=60), "connect_timeout": timedelta(seconds=10)}
    if str(url).startswith("http://") or os.environ.get("AWS_ENDPOINT_URL", "").startswith("http://"):
        options["allow_http"] = True
    try:
        return from_url(str(url), client_options=options, retry_config={"retry_timeout": patience, "max_retries": 20})
    except (obstore.exceptions.BaseError, ValueError) as error:
        raise InputError(f"{url}: not a place for a store ({_first_line(error)})", code="store_url") from None


@contextmanager
def store_errors(url: str | Path) -> Iterator[None]:
    """Turn what file systems and object stores raise inside the block into one clear line."""
    from obstore.exceptions import BaseError

    try:
        with warnings.catch_warnings():
            # Delta is part of the store's contract; Zarr warns of it at each opening.
            warnings.filterwarnings("ignore", message="Numcodecs codecs are not in the Zarr version 3")
            yield
    except OSError as error:
        raise _from_os_error(url, error) from error
    except BaseError as error:
        raise _from_obstore(url, error) from error


@contextmanager
def read_errors(url: str | Path) -> Iterator[None]:
    """The same for reading, where damaged objects and metadata fail in their decoders."""
    with store_errors(url):
        try:
            yield
        except (RuntimeError, ValueError) as error:
            raise StoreError(f"{url}: damaged ({_first_line(error)})", code="store_damaged") from error


def store_exists(url: str | Path) -> bool:
    """Whether a laid-out store is there (a folder that was killed while being laid out is none).

    Raises:
        InputError: no permission, wrong credentials.
        StoreError: the place fails.
    """
    found = open_root(url)
    return found is not None and "schema" in found[1]


def open_root(url: str | Path) -> tuple[Any, dict[str, Any]] | None:
    """The Zarr group at a place, read only, with its attributes; None where there is none.

    Raises:
        InputError: no permission, wrong credentials.
        StoreError: the place fails, or its ``zarr.json`` says nothing that is a group.
    """
    import zarr
    from zarr.errors import GroupNotFoundError

    with read_errors(url):
        try:
            group = zarr.open_group(open_location(url, read_only=True), mode="r", zarr_format=3)
            return group, dict(group.attrs)
        except (GroupNotFoundError, FileNotFoundError):
            return None
        except (TypeError, AttributeError, KeyError) as error:  # what Zarr makes of JSON of another form
            raise StoreError(f"{url}: damaged (its zarr.json is no group's)", code="store_damaged") from error


def read_attributes(url: str | Path, attributes: Mapping[str, Any]) -> Mapping[str, Any]:
    """The same attributes if they are those of a store that this version reads.

    Raises:
        StoreError: another schema, or none.
    """
    schema = attributes.get("schema")
    if schema is None:
        raise StoreError(f"{url}: a Zarr group but no store of drapes, or one killed at its start", code="store_schema")
    if schema != SCHEMA:
        raise StoreError(f"{url}: schema {schema!r} is not the {SCHEMA!r} that this version reads", code="store_schema")
    return attributes


def lost_attributes(attributes: Mapping[str, Any]) -> list[str]:
    """Names of what a store must state of itself and does not, or not in that kind."""
    return [
        name
        for name, kind in ATTRIBUTES.items()
        if not isinstance(attributes.get(name), kind) or isinstance(attributes.get(name), bool)
    ]


def _from_os_error(url: str | Path, error: OSError) -> DrapemeterError:
    if error.errno in NO_ROOM:
        return StoreError(f"{url}: no space is left; make room", code="store_no_space")
    if error.errno in _NOT_ALLOWED:
        return InputError(
            f"{url}: not permitted ({error.strerror}); choose a place you may write to", code="store_not_permitted"
        )
    if isinstance(error, FileNotFoundError):
        return InputError(f"{url}: there is no such folder, bucket or store; check the place", code="store_missing")
    if isinstance(error, NotADirectoryError | IsADirectoryError):
        return InputError(f"{url}: a file or folder is in the way; choose another place", code="store_in_the_way")
    return StoreError(f"{url}: cannot be read or written ({_first_line(error)})", code="store_failed")


def _from_obstore(url: str | Path, error: Exception) -> DrapemeterError:
    from obstore import exceptions

    if isinstance(error, (exceptions.PermissionDeniedError, exceptions.UnauthenticatedError)):
        return InputError(
            f"{url}: the object store refuses these credentials; check AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY",
            code="store_credentials",
        )
    if isinstance(error, exceptions.NotFoundError) or "NoSuchBucket" in str(error):  # a listing says it in words alone
        return InputError(f"{url}: there is no such bucket or store; check the place", code="store_missing")
    return StoreError(f"{url}: the object store fails ({_first_line(error)})", code="store_unreachable")


def _first_line(error: BaseException) -> str:
    text = str(error).strip().splitlines()
    return text[0][:200] if text else type(error).__name__
