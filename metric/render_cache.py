"""Renders kept on disk, so that a fabric is simulated once whatever it is compared with; failures, too."""

from __future__ import annotations

import hashlib
import io
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metric.draping import DrapeRequest, RequestResult
from metric.engine import engine_fingerprint
from metric.render import DrapeRender
from renderer.atomic import write_atomically
from renderer.camera import CANONICAL_CAMERA
from renderer.trim import mark_used, trim_folder
from simcore.drape import OUT_OF_TIME


@dataclass(frozen=True)
class RenderCache:
    """A folder of renders, one file a simulation.

    A file is found again only by a request with the same numbers and by the same simulation and rendering code. One
    of a simulation that did not come to rest has the attempts' failures and no pictures.

    Attributes:
        folder: where the files are.
        most_bytes: how much :meth:`trim` leaves there.
    """

    folder: Path
    most_bytes: int = 10 * 2**30

    def load(self, request: DrapeRequest) -> RequestResult | None:
        """What an earlier run of the same request came to, or None; an unreadable file counts as absent.

        A result that is not :attr:`~metric.draping.RequestResult.settled` has the failures of fewer attempts than are
        asked for now: the others are still to be made.
        """
        try:
            with np.load(self._path(request), allow_pickle=False) as data:
                failures = tuple(str(f) for f in data["failures"])
                # with no more attempts than failed it would not have come to rest
                render = _read_render(data) if "shaded" in data and len(failures) < request.attempts else None
                mark_used(self._path(request))
        except (OSError, zipfile.BadZipFile, zlib.error, EOFError, KeyError, ValueError):
            return None
        if render is None and not _lasting(failures):
            return None
        return RequestResult(request, render, failures[: request.attempts])

    def save(self, result: RequestResult) -> None:
        """Keep a result; one without pictures only if every attempt would fail again."""
        if result.render is None and not _lasting(result.failures):
            return
        self.folder.mkdir(parents=True, exist_ok=True)
        pictures = {} if result.render is None else _pictures(result.render)
        content = io.BytesIO()
        np.savez_compressed(content, allow_pickle=False, failures=np.array(result.failures, dtype=np.str_), **pictures)
        write_atomically(self._path(result.request), content.getvalue())

    def trim(self) -> None:
        """Delete what was not used for longest where more is kept than ``most_bytes``."""
        trim_folder(self.folder, self.most_bytes, ".npz")

    def _path(self, request: DrapeRequest) -> Path:
        words = [
            engine_fingerprint(),
            request.fabric.as_array().tobytes().hex(),
            request.scene.value,
            str(request.repeat),
            str(request.seed),
            repr(request.resolution_m),
        ]
        return self.folder / f"{hashlib.sha256(':'.join(words).encode()).hexdigest()}.npz"


def _lasting(failures: Sequence[str]) -> bool:
    """Whether attempts failed of the fabric alone, not for want of time, of which there may be more next time."""
    return not any(OUT_OF_TIME in failure for failure in failures)


def _pictures(render: DrapeRender) -> dict[str, NDArray[np.generic]]:
    """The arrays of a file by name."""
    return {
        "shaded": render.need_shaded(),
        "depth": render.need_depth(),
        "panel_depth_m": np.array(render.panel_depth_m, np.float64),
    }


def _read_render(data: Mapping[str, NDArray[Any]]) -> DrapeRender:
    """The same from a file.

    Raises:
        KeyError, ValueError: the file is damaged.
    """
    return DrapeRender(
        shaded=data["shaded"],
        depth=data["depth"],
        camera=CANONICAL_CAMERA,
        panel_depth_m=float(data["panel_depth_m"]),
    )
