"""Features kept by content: the same picture is never put through a network twice."""

from __future__ import annotations

import hashlib
import io
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from metric.backends import Backend, Channel, Features
from metric.render import DrapeRender
from renderer.atomic import write_atomically
from renderer.trim import mark_used, trim_folder


class FeatureCache:
    """Least-recently-used features in memory and, if a folder is given, on disk. Not thread-safe.

    Args:
        folder: where to keep features between processes; only back ends whose features are one array use it.
        memory_bytes: most that is kept in memory.
        disk_bytes: most that is kept in the folder; the oldest files go first.
    """

    def __init__(
        self, folder: Path | None = None, *, memory_bytes: int = 512 * 2**20, disk_bytes: int = 2 * 2**30
    ) -> None:
        self.folder = folder
        self.passes = 0
        self._memory: OrderedDict[str, tuple[Features, int]] = OrderedDict()
        self._memory_bytes = memory_bytes
        self._disk_bytes = disk_bytes
        self._held = 0

    def features(self, backend: Backend, renders: Sequence[DrapeRender]) -> list[Features]:
        """Features of each render, computed in one batched call for those not seen before.

        Args:
            backend: the image distance.
            renders: drape renders.

        Raises:
            InputError: as the back end's.
        """
        keys = [feature_key(backend, render) for render in renders]
        known = {key: found for key in dict.fromkeys(keys) if (found := self._look_up(key)) is not None}
        missing = {key: render for key, render in zip(keys, renders, strict=True) if key not in known}
        if missing:
            computed = backend.features(list(missing.values()))
            self.passes += len(missing)
            for key, value in zip(missing, computed, strict=True):
                known[key] = value
                self._keep(key, value)
                self._write(key, value)
            if self.folder is not None:
                trim_folder(self.folder, self._disk_bytes, ".npy")
        return [known[key] for key in keys]

    def _look_up(self, key: str) -> Features | None:
        if key in self._memory:
            self._memory.move_to_end(key)
            return self._memory[key][0]
        if self.folder is None:
            return None
        path = self.folder / f"{key}.npy"
        try:
            value = np.load(path, allow_pickle=False)
            mark_used(path)
        except (OSError, ValueError, EOFError):  # unreadable counts as absent
            return None
        self._keep(key, value)
        return value

    def _keep(self, key: str, value: Features) -> None:
        size = _size(value)
        self._memory[key] = (value, size)
        self._held += size
        while self._held > self._memory_bytes and len(self._memory) > 1:
            self._held -= self._memory.popitem(last=False)[1][1]

    def _write(self, key: str, value: Features) -> None:
        if self.folder is None or not isinstance(value, np.ndarray):
            return
        self.folder.mkdir(parents=True, exist_ok=True)
        content = io.BytesIO()
        np.save(content, value)
        write_atomically(self.folder / f"{key}.npy", content.getvalue())


def feature_key(backend: Backend, render: DrapeRender) -> str:
    """Key of a render's features: back end and content of what it reads."""
    if backend.channel is Channel.SHADED:
        content = render.shaded_key
    else:  # heights and normals depend on where the panel and the camera are, too
        content = f"{render.depth_key}:{render.camera!r}:{render.panel_depth_m!r}"
    return hashlib.sha256(f"{backend.fingerprint}:{content}".encode()).hexdigest()


def _size(value: Any) -> int:
    if isinstance(value, np.ndarray):
        return value.nbytes
    if isinstance(value, (tuple, list)):
        return sum(_size(v) for v in value)
    if is_dataclass(value):
        return sum(_size(getattr(value, field.name)) for field in fields(value))
    return 64
