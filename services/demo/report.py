"""What the demonstration found, as a document and as lines for people."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from renderer.atomic import write_atomically
from services import console
from services.demo.chain import DemoResult
from services.demo.steps import MARKER
from services.plain_json import to_plain
from simcore.parameters import UNITS


def as_document(out: Path, result: DemoResult) -> dict[str, Any]:
    """The JSON document."""
    files = sorted(str(path.relative_to(out)) for path in out.iterdir() if path.name != MARKER)
    return {"out": str(out), "files": files, **to_plain(result)}


def write_document(out: Path, result: DemoResult) -> None:
    """Write the document into the folder; it marks the demonstration as complete."""
    text = json.dumps(as_document(Path(out), result), indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    write_atomically(out / MARKER, text.encode())


def print_summary(result: DemoResult, page: Path) -> None:
    """The estimates' table, the distances and where the pictures are."""
    console.say("fabric   parameter         truth   estimate   90 % interval")
    for row in result.estimates:
        console.say(
            f"{row.fabric:8s} {row.parameter:13s} {row.truth:9.3g} {row.estimate:10.3g}   "
            f"{row.low:.2g} to {row.high:.2g} {UNITS[row.parameter]}"
        )
    matrix = result.distances
    console.say()
    console.say(f"drape distance ({matrix.backend}{', ' + matrix.unit if matrix.unit else ''})")
    console.say(" " * 8 + "".join(f"{name:>9s}" for name in matrix.names))
    for name, values in zip(matrix.names, matrix.values, strict=True):
        console.say(f"{name:8s}" + "".join(f"{value:9.4f}" for value in values))
    if matrix.notice:
        console.say(matrix.notice)
    console.say()
    console.say(f"captures in a draft: {result.gap.sentence}")
    console.say()
    console.say(f"pictures and tables: {page}")
