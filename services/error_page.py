"""The page of error codes: ``python -m services.error_page docs/errors.md`` reads them in the sources and writes it.

Programs look at codes, so each that can be answered stands on a page. A test holds the page to the sources.
"""

from __future__ import annotations

import ast
import sys
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from simcore import errors

PACKAGES = ("simcore", "renderer", "capture", "metric", "trainer", "diagnosis", "services")
KINDS = {
    "InputError": "2 / 422",
    "MissingResourceError": "1 / 503",
    "SimulationError": "1 / 500",
    "OutOfMemoryError": "1 / 500",
    "StoreError": "1 / 500",
    "DrapemeterError": "1 / 500",
    "InferenceBusyError": "- / 503",
    "InferenceTimeoutError": "- / 503",
}
"""Error classes with the exit status of a command and the HTTP status of an answer."""
PROBLEM = "ProblemError"
"""What the service alone answers; it names its HTTP status."""
HEAD = """# Error codes

Written by `python -m services.error_page docs/errors.md` from the sources. The command line prints a code in brackets
behind the message, the REST service and jobs give it as `code`. Codes stay; messages are for people and may change.
`…` stands for what is filled in. Where a code has several messages, one is shown. What the service says of a request as
such (`validation_failed`, `not_found` and their like) is in [api.md](api.md). *Status* is the exit status of a command
/ the HTTP status of an answer; a dash: never so. `simulate` ends with 1 where its own drape is not at rest
(`drape_not_still`). The command line alone says `usage` (2: an option that cannot be read), `path_too_long` (2),
`not_permitted` (2: a place that may not be read or written), `stdout_closed` (1), `cannot_write` (1 where the disk is
full), `interrupted` (130) and `unexpected` (1: a fault of the program); a job that ended without an answer says
`job_crashed` or `job_timed_out`, one that has waited in vain for room on a disk `no_room`.

| code | status | for example |
|---|---|---|
"""


@dataclass(frozen=True)
class Row:
    """One code.

    Attributes:
        code: as programs see it; a star stands for a part that is filled in.
        status: exit status / HTTP status.
        message: one of its messages; empty where none stands in the sources as text.
    """

    code: str
    status: str
    message: str

    def joined(self, other: Row) -> Row:
        """Both of one code: every status, the first message."""
        statuses = [*self.status.split("; "), *other.status.split("; ")]
        return Row(self.code, "; ".join(dict.fromkeys(statuses)), self.message or other.message)


def page(root: Path) -> str:
    """The whole page, of the packages under ``root``."""
    rows: dict[str, Row] = {}
    for package in PACKAGES:
        for path in sorted((root / package).rglob("*.py")):
            for row in rows_of(ast.parse(path.read_text(encoding="utf-8"))):
                known = rows.get(row.code)
                rows[row.code] = row if known is None else known.joined(row)
    lines = (f"| `{row.code}` | {row.status} | {row.message} |" for _, row in sorted(rows.items()))
    return HEAD + "\n".join(lines) + "\n"


def rows_of(module: ast.Module) -> Iterator[Row]:
    """Every code that a module's sources name."""
    shared = dict(_texts(module.body))
    for scope in _scopes(module):
        known = {**shared, **dict(_texts(scope.body))}
        for node in _own(scope):
            if isinstance(node, ast.Call):
                yield from _called(node, known)
            elif isinstance(node, ast.ClassDef) and node.name in KINDS:
                for name, code in _texts(node.body):
                    if name == "code":
                        yield Row(code, KINDS[node.name], _message(ast.Constant(ast.get_docstring(node) or ""), {}))


def _called(node: ast.Call, known: Mapping[str, str]) -> Iterator[Row]:
    """The code that one call gives to an error."""
    name = node.func.id if isinstance(node.func, ast.Name) else getattr(node.func, "attr", "")
    given = next((keyword.value for keyword in node.keywords if keyword.arg == "code"), None)
    if name == PROBLEM and len(node.args) >= 3:
        status, code = node.args[0], _text(node.args[1], known)
        if isinstance(status, ast.Constant) and isinstance(status.value, int) and code:
            yield Row(code, f"- / {status.value}", _message(node.args[2], known))
    elif name in KINDS:
        code = getattr(getattr(errors, name, None), "code", "") if given is None else _text(given, known)
        if code:
            yield Row(code, KINDS[name], _message(node.args[0], known) if node.args else "")


def _scopes(module: ast.Module) -> Iterator[ast.Module | ast.FunctionDef | ast.AsyncFunctionDef]:
    yield module
    for node in ast.walk(module):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node


def _own(scope: ast.Module | ast.FunctionDef | ast.AsyncFunctionDef) -> Iterator[ast.AST]:
    """The nodes of a scope without those of the functions in it."""
    rest: deque[ast.AST] = deque(scope.body)
    while rest:
        node = rest.popleft()
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node
            rest.extend(ast.iter_child_nodes(node))


def _texts(body: Iterable[ast.AST]) -> Iterator[tuple[str, str]]:
    """The names that statements give to texts."""
    for statement in body:
        if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            continue
        for node in ast.walk(statement):
            if isinstance(node, ast.Assign) and len(node.targets) == 1 and isinstance(node.targets[0], ast.Name):
                yield node.targets[0].id, _text(node.value, {})


def _text(node: ast.expr, constants: Mapping[str, str]) -> str:
    """A text as it stands, a star for each part that is filled in; empty where it is made elsewhere."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(str(part.value) if isinstance(part, ast.Constant) else "*" for part in node.values)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return _text(node.left, constants) + _text(node.right, constants)
    if isinstance(node, ast.Name):
        return constants.get(node.id, "")
    return ""


def _message(node: ast.expr, constants: Mapping[str, str]) -> str:
    """A message for a cell of the table; empty where hardly anything of it stands in the sources."""
    text = _text(node, constants)
    words = text.replace("*", "").replace(":", "").strip()
    return text.replace("*", "…").replace("|", "\\|").replace("\n", " ") if len(words) > 8 else ""


def main(arguments: list[str] | None = None) -> None:
    """Write the page to the path that is given."""
    (path,) = sys.argv[1:] if arguments is None else arguments
    Path(path).write_text(page(Path(__file__).resolve().parents[1]), encoding="utf-8")


if __name__ == "__main__":
    main()
