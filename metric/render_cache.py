"""Renders kept on disk, so that a fabric is simulated once whatever it is compared with."""

from __future__ import annotations

import hashlib
import io
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from metric.draping import DrapeRequest, RequestResult
from metric.engine import engine_fingerprint
from metric.render import DrapeRender
from renderer.atomic import write_atomically
from renderer.camera import CANONICAL_CAMERA
from renderer.trim import mark_used, trim_folder


@dataclass(frozen=True)
class RenderCache:
    """A folder of renders, one file a simulation.

    A file is found again only by a request with the same numbers and by the same simulation and rendering code.

    Attributes:
        folder: where the files are.
        most_bytes: how much :meth:`trim` leaves there.
    """

    folder: Path
    most_bytes: int = 10 * 2**30

    def load(self, request: DrapeRequest) -> RequestResult | None:
        """The result of an earlier run of the same request, or None."""
        try:
            with np.load(self._path(request), allow_pickle=False) as data:
                render = DrapeRender(
                    shaded=data["shaded"],
                    depth=data["depth"],
                    camera=CANONICAL_CAMERA,
                    panel_depth_m=float(data["panel_depth_m"]),
                )
                failures = tuple(str(f) for f in data["failures"])
                mark_used(self._path(request))
                # with fewer attempts it would not have come to rest
                return RequestResult(request, render, failures) if len(failures) < request.attempts else None
        except (FileNotFoundError, zipfile.BadZipFile, zlib.error, EOFError, KeyError, ValueError):
            return None

    def save(self, result: RequestResult) -> None:
        """Keep a result whose simulation came to rest."""
        if result.render is None:
            return
        self.folder.mkdir(parents=True, exist_ok=True)
        content = io.BytesIO()
        np.savez_compressed(
            content,
            shaded=result.render.need_shaded(),
            depth=result.render.need_depth(),
            panel_depth_m=np.float64(result.render.panel_depth_m),
            failures=np.array(result.failures, dtype=np.str_),
        )
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
