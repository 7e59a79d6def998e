"""The `drapemeter` command: a table of commands, loaded only when asked for, and errors turned into exit codes."""

from __future__ import annotations

import errno
import importlib
import importlib.util
import os
import signal
import sys
import traceback
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import typer
from typer.main import get_command

from renderer.atomic import NO_ROOM
from services import console
from services.cli.ending import Ending
from simcore.errors import DrapemeterError, InputError, OutOfMemoryError

# Name: one line for `drapemeter --help`. The module of that name in this package offers `register(app)`.
COMMANDS: dict[str, str] = {
    "simulate": "Bring one fabric to rest; write the drape and its picture.",
    "dataset": "Sweep fabrics, scenes and repeats into a store, on Ray.",
    "train": "Train the estimator on a store.",
    "estimate": "Estimate the mechanics of the fabrics in a capture set.",
    "distance": "Drape distance between two fabrics, as people see it.",
    "rank": "Order a library of fabrics by drape distance.",
    "diagnose": "Where simulation and captures part, why, and how far.",
    "blind": "Check the diagnosis on capture sets with sealed labels.",
    "capture": "Record, import and check capture sets.",
    "study": "Prepare, run and analyse a human study.",
    "keys": "Create, list and revoke API keys of the service.",
    "serve": "Run the REST service.",
    "demo": "The whole chain, small, into one folder.",
}

EXIT_FAILURE = 1
EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130
NOT_PERMITTED = (errno.EACCES, errno.EPERM, errno.EROFS)
"""What the system says of a place that is there, but not for whoever runs the command."""

OVERVIEW = """How will it drape? Fabric mechanics from depth pictures, and what a simulator still lacks.

\b
Example:
  drapemeter simulate --scene hanging --parameters p.json --out drape.ply

Every command has --help with an example, --seed, and --json for one JSON document on standard output.

Exit codes: 0 done, 2 bad input (one line says what and how to mend it), 1 failure,
130 interrupted.
"""


def installed_commands() -> dict[str, str]:
    """Commands whose module exists, with their one-line help, without importing any."""
    return {name: text for name, text in COMMANDS.items() if importlib.util.find_spec(_module(name)) is not None}


def build_app(selected: str | None = None) -> typer.Typer:
    """The command line with ``selected`` loaded and the other commands as lines of the overview only.

    Args:
        selected: name of the command that will run; None when only the overview is needed.
    """
    app = typer.Typer(
        name="drapemeter",
        help=OVERVIEW,
        add_completion=False,
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )

    @app.callback(invoke_without_command=True)
    def overview(
        context: typer.Context,
        version: bool = typer.Option(False, "--version", help="Print the version and exit."),
        debug: bool = typer.Option(False, "--debug", help="Show the full traceback of an unexpected error."),
    ) -> None:
        if version:
            from importlib.metadata import version as installed_version

            console.say(f"drapemeter {installed_version('drapemeter')}")
            raise typer.Exit
        if context.invoked_subcommand is None:
            console.say(context.get_help())

    for name, text in installed_commands().items():
        if name == selected:
            importlib.import_module(_module(name)).register(app)
        else:
            app.command(name, help=text)(_not_loaded)
    return app


def run(arguments: Sequence[str]) -> int:
    """Run one command line and return its exit code; errors become one line on standard error."""
    arguments = list(arguments)
    if _replace_closed_streams() and "--json" in arguments:
        console.error_line("standard output is closed: there is nowhere for the JSON document to go", "stdout_closed")
        return EXIT_FAILURE
    debug = "--debug" in arguments[: _command_index(arguments)] or os.environ.get("DRAPEMETER_DEBUG") == "1"
    with console.document_only() if "--json" in arguments else nullcontext():
        try:
            return _invoke(arguments)
        except KeyboardInterrupt:
            console.error_line("interrupted", "interrupted")
            return EXIT_INTERRUPTED
        except typer.TyperException as error:
            context = getattr(error, "ctx", None)
            hint = context.command_path if context else f"drapemeter {_selected(arguments) or ''}".strip()
            console.error_line(f"{error.format_message().rstrip('.')}; see `{hint} --help`", "usage")
            return EXIT_BAD_INPUT
        except DrapemeterError as error:
            if debug:
                traceback.print_exc()
            console.error_line(str(error), error.code)
            return EXIT_BAD_INPUT if isinstance(error, InputError) else EXIT_FAILURE
        except BrokenPipeError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # the reader has left; keep the interpreter from complaining
            return EXIT_FAILURE
        except MemoryError as error:
            if debug:
                traceback.print_exc()
            said = " ".join(str(error).split()) or "Python could get no more"
            text = (
                f"out of memory ({said}): use coarser cells, ask for less at once, or run fewer processes side by side"
            )
            console.error_line(text, OutOfMemoryError.code)
            return EXIT_FAILURE
        except Exception as error:  # noqa: BLE001  the outermost frame: a failure nobody foresaw still gets one line
            if debug:
                traceback.print_exc()
            refused = _refused_by_the_system(error) if isinstance(error, OSError) else None
            if refused is not None:
                text, code, status = refused
                console.error_line(text, code)
                return status
            refusal = getattr(error, "orig", None) if type(error).__module__ == "sqlalchemy.exc" else None
            if refusal is not None:
                console.error_line(f"the database did not do it: {refusal}", "database_unreachable")
                return EXIT_FAILURE
            text = f"unexpected {type(error).__name__}: {error}; `drapemeter --debug ...` shows where"
            console.error_line(text, "unexpected")
            return EXIT_FAILURE


def _refused_by_the_system(error: OSError) -> tuple[str, str, int] | None:
    """What whoever runs the command can mend: the line, its code and the exit status."""
    place = error.filename
    if error.errno == errno.ENAMETOOLONG:
        return f"{place}: {error.strerror}; give a shorter path", "path_too_long", EXIT_BAD_INPUT
    if error.errno in NO_ROOM:
        text = f"cannot write {place or 'what the command makes'}: {error.strerror}; make room, or name another place"
        return text, "cannot_write", EXIT_FAILURE
    if error.errno in NOT_PERMITTED and place:
        text = f"{place}: not permitted ({error.strerror}); name a place that you may read and write"
        return text, "not_permitted", EXIT_BAD_INPUT
    return None


def _replace_closed_streams() -> bool:
    """Give a stream that is closed (`>&-`) somewhere to go; whether standard output was."""
    closed = sys.stdout is None
    if closed:
        sys.stdout = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115  until the process ends
    if sys.stderr is None:
        sys.stderr = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115
    return closed


def main() -> None:
    """Entry point of the console script; a scheduler's SIGTERM ends a command as Ctrl-C does."""
    ending = Ending.prepared()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    ending.status = run(sys.argv[1:])
    sys.exit(ending.status)


def _invoke(arguments: list[str]) -> int:
    command = get_command(build_app(_selected(arguments)))
    outcome: Any = command.main(arguments, prog_name="drapemeter", standalone_mode=False)
    if outcome == EXIT_INTERRUPTED:  # what Typer makes of it
        raise KeyboardInterrupt
    return outcome if isinstance(outcome, int) else 0


def _module(name: str) -> str:
    return f"services.cli.{name}"


def _command_index(arguments: Sequence[str]) -> int:
    """Position of the command's name; all options before it are flags."""
    return next((i for i, argument in enumerate(arguments) if not argument.startswith("-")), len(arguments))


def _selected(arguments: Sequence[str]) -> str | None:
    index = _command_index(arguments)
    return arguments[index] if index < len(arguments) and arguments[index] in COMMANDS else None


def _not_loaded() -> None:
    """Stands for a command in the overview; the one that runs is always loaded."""
    raise AssertionError("a command was invoked without being selected")
