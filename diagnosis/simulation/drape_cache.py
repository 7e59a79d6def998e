"""Drapes on disk, addressed by what they were made from."""

from __future__ import annotations

import dataclasses
import hashlib
import inspect
import io
import json
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from renderer.atomic import write_atomically
from renderer.trim import mark_used, trim_folder
from renderer.user_cache import default_cache_folder
from simcore.drape import Drape, DrapeStatus
from simcore.errors import InputError
from simcore.mechanics import Jitter, Mechanics
from simcore.mesh import GridMesh
from simcore.parameters import FabricParameters
from simcore.scenes import Setup
from simcore.version import SOLVER_VERSION


def content_key(**parts: Any) -> str:
    """SHA-256 over the parts, hexadecimal; dataclasses by their fields, arrays by their bytes."""
    return hashlib.sha256(json.dumps(parts, default=_plain, sort_keys=True).encode()).hexdigest()


def drape_key(
    mesh: GridMesh,
    fabric: FabricParameters,
    setup: Setup,
    mechanics: Mechanics,
    *,
    seed: int = 0,
    jitter: Jitter | None = None,
    start: str | None = None,
) -> str:
    """Key of a simulation; ``start`` is the key of the drape it continues from."""
    return content_key(
        version=SOLVER_VERSION,
        mesh=[mesh.resolution_m, *mesh.size_m],
        fabric=fabric.as_dict(),
        setup=setup,
        mechanics=mechanics,
        seed=seed,
        jitter=jitter,
        start=start,
    )


OWN_PACKAGES = ("simcore", "renderer", "capture", "diagnosis")
"""Whose classes are told by their fields; they change with a version."""
UNREADABLE = (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error)
"""What a damaged file of the cache raises when it is read."""


USERS_MOST_BYTES = 20 * 2**30
"""Of the user's cache: a diagnosis adds 15 MB (1.0 GB after 67 sets of 4 fabrics)."""


@dataclass(frozen=True)
class DrapeCache:
    """A folder of drapes.

    Attributes:
        folder: None keeps nothing.
        learns: fold states that captures show are kept as such, for later captures of the fabric.
        most_bytes: how much :meth:`trim` leaves; None is no limit.
    """

    folder: Path | None
    learns: bool = True
    most_bytes: int | None = None

    @classmethod
    def default(cls) -> DrapeCache:
        """``DRAPEMETER_CACHE`` (empty: no cache), else a folder of the user's cache; of 20 GiB at most."""
        folder = default_cache_folder()
        return cls(None if folder is None else folder / "drapes", most_bytes=USERS_MOST_BYTES)

    def get(self, key: str, mesh: GridMesh) -> Drape | None:
        """The drape of a key, or None; an unreadable file counts as absent."""
        if self.folder is None:
            return None
        try:
            with np.load(self._path(key)) as data:
                facts = json.loads(str(data["facts"]))
                vertices = data["vertices"]
            status = DrapeStatus(facts.pop("status"))
        except UNREADABLE:
            return None
        if vertices.shape != (mesh.vertex_count, 3):
            return None
        self._mark_used(key)
        return Drape(mesh, vertices, status, **facts)

    def put(self, key: str, drape: Drape) -> None:
        """Keep a drape."""
        if self.folder is None:
            return
        path = self._path(key)
        path.parent.mkdir(parents=True, exist_ok=True)
        facts = {
            "status": drape.status.value,
            "residual": drape.residual,
            "energy": drape.energy,
            "stable": drape.stable,
            "iterations": drape.iterations,
            "seconds": drape.seconds,
            "reason": drape.reason,
        }
        content = io.BytesIO()
        np.savez(content, vertices=drape.vertices, facts=json.dumps(facts))
        write_atomically(path, content.getvalue())

    def has(self, key: str) -> bool:
        """Whether something is kept under a key."""
        return self.folder is not None and self._path(key).is_file()

    def get_arrays(self, key: str) -> dict[str, NDArray[np.float64]] | None:
        """Named arrays of a key, or None; an unreadable file counts as absent."""
        if self.folder is None:
            return None
        try:
            with np.load(self._path(key)) as data:
                found = {name: np.asarray(data[name], dtype=np.float64) for name in data.files}
        except UNREADABLE:
            return None
        self._mark_used(key)
        return found

    def put_arrays(self, key: str, arrays: Mapping[str, NDArray[np.float64]]) -> None:
        """Keep named arrays, as float32 (they are differences of pictures)."""
        if self.folder is None:
            return
        path = self._path(key)
        path.parent.mkdir(parents=True, exist_ok=True)
        content = io.BytesIO()
        compact: dict[str, Any] = {name: value.astype(np.float32) for name, value in arrays.items()}
        np.savez_compressed(content, **compact)
        write_atomically(path, content.getvalue())

    def files(self) -> dict[str, bytes]:
        """Everything that is kept, by its place in the folder."""
        if self.folder is None:
            return {}
        paths = sorted(path for path in self.folder.rglob("*") if path.is_file())
        return {path.relative_to(self.folder).as_posix(): path.read_bytes() for path in paths}

    def take(self, files: Mapping[str, bytes]) -> None:
        """Keep another cache's :meth:`files`, too."""
        if self.folder is None:
            return
        for place, content in files.items():
            path = self.folder / place
            path.parent.mkdir(parents=True, exist_ok=True)
            write_atomically(path, content)

    def trim(self) -> None:
        """Delete what was not used for longest where more is kept than ``most_bytes``."""
        if self.folder is not None and self.most_bytes is not None:
            trim_folder(self.folder, self.most_bytes, ".npz")

    def _mark_used(self, key: str) -> None:
        if self.most_bytes is not None:
            mark_used(self._path(key))

    def _path(self, key: str) -> Path:
        assert self.folder is not None
        return self.folder / key[:2] / f"{key}.npz"


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {f.name: getattr(value, f.name) for f in dataclasses.fields(value) if not _is_later(f, value)}
        return fields if _is_own(type(value)) else [_source(type(value)), fields]
    text = str(value)
    if " object at 0x" in text:
        raise InputError(
            f"{type(value).__qualname__}: what changes a scene must be a dataclass, so that simulations with it can be "
            "told from others",
            code="effect_file",
        )
    return text


def _is_later(field: dataclasses.Field[Any], value: Any) -> bool:
    """A field that came later and is at its default: what was kept before it came is still right."""
    return bool(field.metadata.get("later")) and getattr(value, field.name) == field.default


def _is_own(kind: type) -> bool:
    """Not of a file that a user may have added to the catalogue."""
    module = kind.__module__
    return module.split(".")[0] in OWN_PACKAGES and not module.startswith("diagnosis.effects.")


@cache
def _source(kind: type) -> str:
    """What a class that is not the program's own is and does: two may have the same fields, and change.

    By all of its file: what it does may lie in a function beside it.
    """
    module = inspect.getmodule(kind)
    try:
        text = inspect.getsource(kind if module is None else module)
    except (OSError, TypeError):  # written nowhere: by its name
        text = ""
    return f"{kind.__module__}.{kind.__qualname__} {hashlib.sha256(text.encode()).hexdigest()}"
