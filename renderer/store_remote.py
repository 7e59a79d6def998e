"""An object store that is patient: what fails for a passing reason is asked again."""

from __future__ import annotations

import asyncio
import math
import os
import time
from collections.abc import AsyncGenerator, Awaitable, Callable, Iterable
from typing import TYPE_CHECKING, Any, TypeVar

from obstore import exceptions
from zarr.storage import ObjectStore

from simcore.errors import InputError

if TYPE_CHECKING:
    from zarr.abc.store import ByteRequest
    from zarr.core.buffer import Buffer, BufferPrototype

Result = TypeVar("Result")

FIRST_WAIT_S = 0.1
LONGEST_WAIT_S = 5.0
MOST_PATIENCE_S = 366 * 86400.0


def patience_s() -> float:
    """Seconds for which a request is repeated (``DRAPEMETER_STORE_RETRY_S``, two minutes where nothing is said).

    Raises:
        InputError: the variable holds no such number.
    """
    named = os.environ.get("DRAPEMETER_STORE_RETRY_S") or "120"
    try:
        seconds = float(named)
    except ValueError:
        seconds = math.nan
    if not 0.0 <= seconds <= MOST_PATIENCE_S:
        raise InputError(
            f"DRAPEMETER_STORE_RETRY_S is {named!r}: give the seconds for which requests are repeated, "
            f"from 0 to {MOST_PATIENCE_S:.0f}",
            code="setting_invalid",
        )
    return seconds


class PatientObjectStore(ObjectStore[Any]):
    """Zarr's object store with retries around whole requests.

    obstore itself repeats requests that are refused or answered "busy", but not those whose answer breaks off in its
    body. Everything here may be repeated: objects are written whole.
    """

    async def get(self, key: str, prototype: BufferPrototype, byte_range: ByteRequest | None = None) -> Buffer | None:
        """An object or a range of it, None where there is none."""
        return await _patiently(lambda: super(PatientObjectStore, self).get(key, prototype, byte_range))

    async def get_partial_values(
        self, prototype: BufferPrototype, key_ranges: Iterable[tuple[str, ByteRequest | None]]
    ) -> list[Buffer | None]:
        """Several ranges."""
        ranges = list(key_ranges)
        return await _patiently(lambda: super(PatientObjectStore, self).get_partial_values(prototype, ranges))

    async def exists(self, key: str) -> bool:
        """Whether an object is there."""
        return await _patiently(lambda: super(PatientObjectStore, self).exists(key))

    async def set(self, key: str, value: Buffer) -> None:
        """Write an object whole."""
        await _patiently(lambda: super(PatientObjectStore, self).set(key, value))

    async def delete(self, key: str) -> None:
        """Remove an object if it is there."""
        await _patiently(lambda: super(PatientObjectStore, self).delete(key))

    async def delete_dir(self, prefix: str) -> None:
        """Remove all objects below a prefix."""
        await _patiently(lambda: super(PatientObjectStore, self).delete_dir(prefix))

    async def getsize(self, key: str) -> int:
        """Bytes of an object."""
        return await _patiently(lambda: super(PatientObjectStore, self).getsize(key))

    async def list(self) -> AsyncGenerator[str, None]:
        """Every key."""
        for key in await _patiently(lambda: _collect(super(PatientObjectStore, self).list())):
            yield key

    async def list_prefix(self, prefix: str) -> AsyncGenerator[str, None]:
        """Every key that begins so."""
        for key in await _patiently(lambda: _collect(super(PatientObjectStore, self).list_prefix(prefix))):
            yield key

    async def list_dir(self, prefix: str) -> AsyncGenerator[str, None]:
        """Names directly below a prefix."""
        for key in await _patiently(lambda: _collect(super(PatientObjectStore, self).list_dir(prefix))):
            yield key


async def _collect(keys: AsyncGenerator[str, None]) -> list[str]:
    return [key async for key in keys]


async def _patiently(request: Callable[[], Awaitable[Result]]) -> Result:
    """Repeat a request with growing pauses while it fails for a reason that may pass."""
    until, wait = time.monotonic() + patience_s(), FIRST_WAIT_S
    while True:
        try:
            return await request()
        except exceptions.GenericError:
            if time.monotonic() + wait > until:
                raise
        await asyncio.sleep(wait)
        wait = min(2.0 * wait, LONGEST_WAIT_S)
