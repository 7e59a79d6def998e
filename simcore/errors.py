"""One error tree for the whole project.

Every error carries a stable ``code`` for programs and a message for people that says what was wrong and how to mend
it. Entry points map the classes: :class:`InputError` -> exit status 2 / HTTP 4xx, everything else -> 1 / HTTP 5xx.
"""

from __future__ import annotations


class DrapemeterError(Exception):
    """Base of every error the project raises on purpose.

    Args:
        message: what was wrong and how to mend it, one line.
        code: stable machine-readable kind, ``lower_snake_case``; defaults to the class's own.
    """

    code: str = "drapemeter_error"

    def __init__(self, message: str, *, code: str | None = None) -> None:
        super().__init__(message)
        if code is not None:
            self.code = code

    def __reduce__(self) -> tuple[object, ...]:
        # Ray and multiprocessing pickle errors: keep the code.
        return (_rebuild, (type(self), self.args[0] if self.args else "", self.code))


def _rebuild(cls: type[DrapemeterError], message: str, code: str) -> DrapemeterError:
    return cls(message, code=code)


class InputError(DrapemeterError):
    """What the caller gave cannot be used; nothing was written."""

    code = "bad_input"


class MissingResourceError(DrapemeterError):
    """Something the machine should have is not there (weights, a system library, a service)."""

    code = "missing_resource"


class SimulationError(DrapemeterError):
    """A simulation that was needed did not come to rest, or could not be carried out."""

    code = "simulation_failed"


class OutOfMemoryError(SimulationError):
    """A simulation found too little memory; the same may do where others leave more."""

    code = "out_of_memory"


class StoreError(DrapemeterError):
    """A store cannot be read or written."""

    code = "store_failed"
