"""What every command has, whatever it does: --seed, --json, an example in its --help."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import pytest
from typer.main import get_command

from services.cli import main


def walk(path: tuple[str, ...], command: Any) -> Iterator[tuple[tuple[str, ...], Any]]:
    """A command and those below it that do work: leaves, and groups that also run by themselves."""
    below = getattr(command, "commands", {})
    if not below or command.invoke_without_command:
        yield path, command
    for name, inner in below.items():
        yield from walk((*path, name), inner)


def working_commands() -> dict[tuple[str, ...], Any]:
    found = {}
    for name in main.installed_commands():
        top: Any = get_command(main.build_app(name))
        found |= dict(walk((name,), top.commands[name]))
    return found


COMMANDS = working_commands()


def test_the_walk_reaches_the_commands_below_the_groups() -> None:
    assert {("simulate",), ("dataset",), ("dataset", "merge"), ("capture", "schema"), ("keys", "create")} <= set(
        COMMANDS
    )
    assert {path[0] for path in COMMANDS} == set(main.COMMANDS)
    assert len(COMMANDS) >= 28


@pytest.mark.parametrize("path", COMMANDS, ids=" ".join)
def test_every_command_has_a_seed_json_and_an_example(
    path: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    options = {option for parameter in COMMANDS[path].params for option in parameter.opts}
    assert {"--seed", "--json"} <= options
    assert main.run([*path, "--help"]) == 0
    text = capsys.readouterr().out
    assert "Example" in text
    assert f"drapemeter {' '.join(path)}" in text
    assert "--seed" in text and "--json" in text


def test_groups_have_an_example(capsys: pytest.CaptureFixture[str]) -> None:
    for name in {path[0] for path in COMMANDS if len(path) > 1}:
        assert main.run([name, "--help"]) == 0
        assert f"drapemeter {name} " in capsys.readouterr().out.partition("Example")[2]


def test_a_seed_changes_nothing_where_nothing_is_random(capsys: pytest.CaptureFixture[str]) -> None:
    documents = []
    for more in ([], ["--seed", "3"], ["--json"], ["--seed", "3", "--json"]):
        assert main.run(["capture", "schema", *more]) == 0
        documents.append(json.loads(capsys.readouterr().out))
    assert all(document == documents[0] for document in documents)
    assert main.run(["capture", "schema", "--seed", "-1"]) == 2
    assert main.run(["capture", "schema", "--seed", "one"]) == 2
    assert capsys.readouterr().err.count("[usage]") == 2


def test_study_serve_says_where_as_json(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    @contextmanager
    def study(*_: object) -> Iterator[Any]:
        yield SimpleNamespace(study=SimpleNamespace(name="pilot"))

    served = []

    def run(_: Any, sockets: list[socket.socket]) -> None:
        served.append(sockets[0].getsockname()[1])
        raise KeyboardInterrupt

    monkeypatch.setattr("services.cli.study.open_study", study)
    monkeypatch.setattr("services.web.study_app.create_study_app", lambda store: None)
    monkeypatch.setattr("uvicorn.Server.run", run)
    assert main.run(["study", "serve", "study_0", "--port", "0", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"study": "study_0", "url": f"http://127.0.0.1:{served[0]}/"}
    with socket.create_server(("127.0.0.1", 0)) as taken:
        assert main.run(["study", "serve", "study_0", "--port", str(taken.getsockname()[1]), "--json"]) == 2
    assert "[cannot_listen]" in capsys.readouterr().err
    assert len(served) == 1
