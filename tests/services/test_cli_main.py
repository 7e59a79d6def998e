"""The command line's frame: lazy loading, one line per error, exit codes, one JSON document."""

from __future__ import annotations

import errno
import json
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import typer

from services import console
from services.cli import main
from services.cli.outputs import check_file
from simcore.errors import InputError, SimulationError


@pytest.fixture
def probe(monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[], None]], None]:
    """Puts a function in the place of the command `simulate`."""

    class Module:
        @staticmethod
        def register(app: typer.Typer) -> None:
            @app.command("simulate")
            def simulate(
                json_output: bool = typer.Option(False, "--json"),
                count: int = typer.Option(1, "--count"),
            ) -> None:
                Module.body()

        body: Callable[[], None] = staticmethod(lambda: None)

    monkeypatch.setattr(main, "installed_commands", lambda: {"simulate": "probe"})
    monkeypatch.setitem(sys.modules, "services.cli.simulate", Module)

    def put(body: Callable[[], None]) -> None:
        Module.body = staticmethod(body)

    return put


def raiser(error: BaseException) -> Callable[[], None]:
    def body() -> None:
        raise error

    return body


@pytest.mark.parametrize(
    ("error", "status", "line"),
    [
        (InputError("no such\nthing", code="thing_missing"), 2, "error: no such thing [thing_missing]"),
        (SimulationError("not still"), 1, "error: not still [simulation_failed]"),
        (KeyboardInterrupt(), 130, "error: interrupted [interrupted]"),
    ],
)
def test_errors_become_one_line_and_an_exit_code(
    probe: Callable[[Callable[[], None]], None],
    capsys: pytest.CaptureFixture[str],
    error: BaseException,
    status: int,
    line: str,
) -> None:
    probe(raiser(error))
    assert main.run(["simulate", "--json"]) == status
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err == line + "\n"


def test_the_overview_names_every_exit_code() -> None:
    said = {int(number) for number in re.findall(r"\d+", main.OVERVIEW.partition("Exit codes: ")[2])}
    assert said == {0, main.EXIT_FAILURE, main.EXIT_BAD_INPUT, main.EXIT_INTERRUPTED}


def test_an_unforeseen_error_is_one_line_and_debug_shows_the_traceback(
    probe: Callable[[Callable[[], None]], None], capsys: pytest.CaptureFixture[str]
) -> None:
    probe(raiser(RuntimeError("boom")))
    assert main.run(["simulate"]) == 1
    assert capsys.readouterr().err.count("\n") == 1
    assert main.run(["--debug", "simulate"]) == 1
    assert "Traceback" in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [["nonsense"], ["simulate", "--nonsense"], ["simulate", "--count", "many"]])
def test_usage_errors_exit_with_2_and_name_the_help(
    probe: Callable[[Callable[[], None]], None], capsys: pytest.CaptureFixture[str], arguments: list[str]
) -> None:
    probe(lambda: None)
    assert main.run(arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert "--help" in captured.err


@pytest.mark.parametrize(
    ("arguments", "hint"),
    [
        (["capture"], "drapemeter capture --help"),
        (["study"], "drapemeter study --help"),
        (["keys"], "drapemeter keys --help"),
        (["blind"], "drapemeter blind --help"),
        (["capture", "import", "--nonsense"], "drapemeter capture import --help"),
        (["study", "compare", "--nonsense"], "drapemeter study compare --help"),
    ],
)
def test_a_usage_error_of_a_subcommand_names_its_own_help(
    arguments: list[str], hint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main.run(arguments) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and len(said) < 200
    assert f"`{hint}`" in said


def test_a_full_disk_is_one_line_with_the_path(
    probe: Callable[[Callable[[], None]], None], capsys: pytest.CaptureFixture[str]
) -> None:
    def body() -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "cache/x.npz")

    probe(body)
    assert main.run(["simulate"]) == 1
    line = capsys.readouterr().err
    assert line.count("\n") == 1 and "cache/x.npz" in line and line.endswith("[cannot_write]\n")


def test_a_path_that_the_system_does_not_take_is_bad_input(capsys: pytest.CaptureFixture[str]) -> None:
    assert main.run(["diagnose", "x" * 300, "--out", "out"]) == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1 and "give a shorter path [path_too_long]" in line


@pytest.mark.parametrize("refusal", main.NOT_PERMITTED)
def test_a_place_that_may_not_be_used_is_bad_input(
    probe: Callable[[Callable[[], None]], None], capsys: pytest.CaptureFixture[str], refusal: int
) -> None:
    probe(raiser(OSError(refusal, os.strerror(refusal), "theirs/p.json")))
    assert main.run(["simulate"]) == 2
    said = capsys.readouterr().err
    line = f"theirs/p.json: not permitted ({os.strerror(refusal)}); name a place that you may read and write"
    assert said == f"error: {line} [not_permitted]\n"


def test_what_is_not_permitted_and_is_no_place_is_not_told_as_one(
    probe: Callable[[Callable[[], None]], None], capsys: pytest.CaptureFixture[str]
) -> None:
    probe(raiser(OSError(errno.EPERM, os.strerror(errno.EPERM))))
    assert main.run(["simulate"]) == 1
    assert capsys.readouterr().err.endswith("[unexpected]\n")


@contextmanager
def as_nobody() -> Iterator[None]:
    """Without the rights of the system's administrator, who may enter every folder."""
    administrator = os.geteuid() == 0
    if administrator:
        os.seteuid(65534)
    try:
        yield
    finally:
        if administrator:
            os.seteuid(0)


def test_a_folder_that_may_not_be_entered_is_bad_input(
    probe: Callable[[Callable[[], None]], None], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    shut = tmp_path / "shut"
    shut.mkdir(mode=0)

    def body() -> None:
        with as_nobody():
            check_file(shut / "inner" / "page.md")

    probe(body)
    assert main.run(["simulate"]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and str(shut / "inner" / "page.md") in said and said.endswith("[not_permitted]\n")


def test_json_keeps_other_prints_off_standard_output(
    probe: Callable[[Callable[[], None]], None], capsys: pytest.CaptureFixture[str]
) -> None:
    def body() -> None:
        print("[Library] hello")
        console.emit_json({"residual": float("nan"), "pair": (1, 2.5)})

    probe(body)
    assert main.run(["simulate", "--json"]) == 0
    captured = capsys.readouterr()
    assert json.loads(captured.out) == {"residual": None, "pair": [1, 2.5]}
    assert "[Library] hello" in captured.err


def test_json_keeps_compiled_code_off_standard_output() -> None:
    program = (
        "import os\n"
        "from services import console\n"
        "with console.document_only():\n"
        "    os.write(1, b'[compiled] hello\\n')\n"
        "    console.emit_json({'a': 1})\n"
        "print('after')\n"
    )
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert result.stdout == '{"a": 1}\nafter\n'
    assert result.stderr == "[compiled] hello\n"


@pytest.mark.parametrize(
    ("redirection", "code"), [(">/dev/full", "cannot_write"), ("| true", None), (">&-", "stdout_closed")]
)
def test_a_document_that_cannot_go_out_is_one_line_and_no_traceback(redirection: str, code: str | None) -> None:
    program = (
        "import sys; from services import console; from services.cli import main; "
        "main._invoke = lambda arguments: console.emit_json({'a': 'b' * 200_000}); "
        "sys.exit(main.run(['simulate', '--json']))"
    )
    line = f"set -o pipefail; '{sys.executable}' -c \"{program}\" {redirection}"
    result = subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=False)
    assert result.returncode == 1
    assert "Traceback" not in result.stderr and "Exception" not in result.stderr
    lines = result.stderr.strip().splitlines()
    assert len(lines) == (0 if code is None else 1)
    assert code is None or lines[0].endswith(f"[{code}]")


def test_a_name_that_is_no_text_is_escaped(
    probe: Callable[[Callable[[], None]], None], capsys: pytest.CaptureFixture[str]
) -> None:
    def body() -> None:
        console.emit_json({"file": "th\udce9.png", "name": "caf\u00e9"})

    probe(body)
    assert main.run(["simulate", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"file": "th\udce9.png", "name": "caf\u00e9"}


def test_the_overview_lists_the_commands_and_imports_nothing_heavy() -> None:
    program = (
        "import sys\n"
        "from services.cli import main\n"
        "main.run(['--help'])\n"
        "heavy = {'torch', 'taichi', 'open3d', 'ray', 'matplotlib', 'kornia', 'fastapi', 'sqlalchemy', 'scipy'}\n"
        "sys.exit(', '.join(sorted(heavy & set(sys.modules))) or None)\n"
    )
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    for name in main.installed_commands():
        assert f"\n  {name} " in result.stdout
