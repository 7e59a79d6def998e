"""Commands in README and documents: there are such commands, with such options and arguments."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import pytest

from services.cli import main
from tests.services.test_cli_options import COMMANDS

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
ENDS = frozenset("|&;<>")


def told(page: Path) -> list[str]:
    """Whole command lines of a page: indented, in fences, or in back quotes with an option or an argument."""
    text = page.read_text(encoding="utf-8").replace("\\\n", " ")
    lines = re.findall(r"^ *(?:for .*do +)?(drapemeter .*)$", text, flags=re.MULTILINE)
    return lines + re.findall(r"`(drapemeter [^`]+)`", text)


def words(line: str) -> list[str]:
    """What the command is given, without comments and what a shell does after it."""
    lexer = shlex.shlex(line.replace("$(", "(").replace("...", ""), posix=True, punctuation_chars="|&;<>")
    lexer.whitespace_split, lexer.commenters = True, "#"
    found: list[str] = []
    for word in lexer:
        if word and set(word) <= ENDS:
            break
        found.append(word)
    return found[1:]


def command_of(given: list[str]) -> tuple[Any, list[str]] | None:
    """The longest command that the words name, and the rest of them."""
    for length in (2, 1):
        if tuple(given[:length]) in COMMANDS:
            return COMMANDS[tuple(given[:length])], given[length:]
    return None


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_of_the_documents_exist_with_their_options(page: Path) -> None:
    for line in told(page):
        given = words(line)
        if not given or given[0].startswith("-") or given[0].isupper():  # drapemeter --help, drapemeter COMMAND
            continue
        assert given[0] in main.installed_commands(), line
        found = command_of(given)
        if found is None:  # a group by itself: `drapemeter blind`
            assert len(given) == 1 or given[1].startswith(("-", "<")), line
            continue
        command, rest = found
        options = {o for parameter in command.params for o in (*parameter.opts, *parameter.secondary_opts)}
        for word in rest:
            if word.startswith("--"):
                assert word.partition("=")[0] in options | {"--help"}, f"{word} in: {line}"


def test_the_documents_tell_commands() -> None:
    assert sum(len(told(page)) for page in PAGES) > 60
