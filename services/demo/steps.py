"""What the steps of the demonstration share: announcing, timing, the folder."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from services import console
from simcore.errors import InputError

MARKER = "demo.json"
"""The file that ends a demonstration and by whose content a folder is known as one."""
_UNDER_WAY = {"demonstration": "drapemeter"}
_ENDED = frozenset({"out", "files", "estimates", "distances"})
"""Some keys of the document."""


@dataclass
class StepClock:
    """Announces the steps on standard error and keeps their times [s]."""

    total: int
    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def step(self, title: str, work: float | None = None) -> Iterator[console.ProgressBar]:
        """One step, with a bar where standard error is a terminal."""
        console.note(f"[{len(self.seconds) + 1}/{self.total}] {title}")
        began = time.monotonic()
        with console.progress(title, work) as bar:
            yield bar
        self.seconds[title] = time.monotonic() - began


def prepare_folder(out: Path) -> None:
    """Make the folder; an earlier demonstration there is replaced, anything else is left alone.

    Raises:
        InputError: the folder holds something else, or cannot be made.
    """
    try:
        if out.is_dir() and any(out.iterdir()):
            if not _is_ours(out / MARKER):
                raise InputError(
                    f"{out} is not empty and holds no earlier demonstration: give --out another folder",
                    code="folder_not_empty",
                )
            for path in out.iterdir():  # all but the mark: when this is interrupted, the folder is still known
                if path.name != MARKER:
                    path.unlink() if path.is_symlink() or not path.is_dir() else shutil.rmtree(path)
        out.mkdir(parents=True, exist_ok=True)
        (out / MARKER).write_text(json.dumps(_UNDER_WAY) + "\n", encoding="utf-8")
    except OSError as error:
        raise InputError(f"cannot make the folder {out}: {error.strerror or error}", code="cannot_write") from None


def _is_ours(marker: Path) -> bool:
    """Whether a demonstration has begun or ended in the marker's folder: other programs have a ``demo.json``, too."""
    try:
        said = json.loads(marker.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(said, dict) and (said == _UNDER_WAY or said.keys() >= _ENDED)
