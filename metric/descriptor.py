"""What a library keeps of each fabric: sketches of its renders and two small pictures."""

from __future__ import annotations

import hashlib
import io
import zipfile
import zlib
from collections import OrderedDict
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from metric.drape_distance import RenderSets
from metric.engine import engine_fingerprint
from metric.feature_cache import FeatureCache
from metric.render import DrapeRender
from metric.simulate import SimulationPlan
from metric.sketch import Sketched
from renderer.atomic import write_atomically
from renderer.trim import mark_used, trim_folder
from simcore.parameters import FabricParameters
from simcore.scenes import Scene

_THUMBNAIL_SHRINK = 2


@dataclass(frozen=True)
class FabricDescriptor:
    """One fabric as the index sees it.

    Attributes:
        sketches: by scene, one row a render, float32, shape [N, K].
        pictures: by scene, the first repeat's shaded picture at half size, uint8, shape [H / 2, W / 2].
    """

    sketches: dict[Scene, NDArray[np.float32]]
    pictures: dict[Scene, NDArray[np.uint8]]

    @property
    def nbytes(self) -> int:
        """Memory that its arrays take [bytes]."""
        return sum(rows.nbytes for rows in self.sketches.values()) + sum(p.nbytes for p in self.pictures.values())


def describe(renders: RenderSets, backend: Sketched, cache: FeatureCache) -> FabricDescriptor:
    """Descriptor of a fabric's renders.

    Args:
        renders: by scene.
        backend: makes the sketches.
        cache: keeps them by content.
    """
    return FabricDescriptor(
        {scene: np.stack(cache.features(backend, sets)) for scene, sets in renders.items()},
        {scene: thumbnail(sets[0]) for scene, sets in renders.items()},
    )


def thumbnail(render: DrapeRender) -> NDArray[np.uint8]:
    """The shaded picture at half size, uint8, shape [H / 2, W / 2]."""
    picture = render.need_shaded()
    step = _THUMBNAIL_SHRINK
    height, width = picture.shape[0] // step * step, picture.shape[1] // step * step
    blocks = picture[:height, :width].reshape(height // step, step, width // step, step, -1).mean(axis=(1, 3, 4))
    small: NDArray[np.uint8] = np.rint(blocks).astype(np.uint8)
    return small


def descriptor_key(fabric: FabricParameters, first_repeat: int, plan: SimulationPlan, backend: Sketched) -> str:
    """Key of the descriptor that simulating and describing the fabric would give."""
    words = [
        engine_fingerprint(),
        backend.fingerprint,
        fabric.as_array().tobytes().hex(),
        ",".join(plan.scenes),
        *(str(n) for n in (first_repeat, plan.simulations, plan.seed)),
        repr(plan.resolution_m),
        str(plan.attempts),
    ]
    return hashlib.sha256(":".join(words).encode()).hexdigest()


@dataclass
class DescriptorStore:
    """Descriptors in memory and, if a folder is given, on disk. Not thread-safe.

    Attributes:
        folder: one file a fabric; None for memory alone.
        most: descriptors held in memory where a folder keeps the others; those not used for longest go first.
        most_bytes: kept in the folder.
        memory_bytes: held in memory, with a folder or without; the last one stays, however large.
    """

    folder: Path | None = None
    most: int = 256
    most_bytes: int = 20 * 2**30
    memory_bytes: int = 2**30
    _memory: OrderedDict[str, FabricDescriptor] = field(default_factory=OrderedDict)
    _held: int = 0

    def load(self, key: str) -> FabricDescriptor | None:
        """A kept descriptor, or None; an unreadable file counts as absent."""
        if key in self._memory:
            self._memory.move_to_end(key)
            return self._memory[key]
        if self.folder is None:
            return None
        path = self.folder / f"{key}.npz"
        try:
            with np.load(path, allow_pickle=False) as data:
                mark_used(path)
                found = FabricDescriptor(
                    {Scene(n.split("-")[1]): data[n] for n in data.files if n.startswith("sketches-")},
                    {Scene(n.split("-")[1]): data[n] for n in data.files if n.startswith("picture-")},
                )
        except (OSError, zipfile.BadZipFile, zlib.error, EOFError, KeyError, ValueError):
            return None
        self._hold(key, found)
        return found

    def save(self, key: str, descriptor: FabricDescriptor) -> None:
        """Keep a descriptor."""
        self._hold(key, descriptor)
        if self.folder is None:
            return
        self.folder.mkdir(parents=True, exist_ok=True)
        arrays = {f"sketches-{scene}": rows for scene, rows in descriptor.sketches.items()}
        pictures = {f"picture-{scene}": picture for scene, picture in descriptor.pictures.items()}
        content = io.BytesIO()
        np.savez(content, allow_pickle=False, **arrays, **pictures)
        write_atomically(self.folder / f"{key}.npz", content.getvalue())

    def trim(self) -> None:
        """Delete what was not used for longest where more is kept than ``most_bytes``."""
        if self.folder is not None:
            trim_folder(self.folder, self.most_bytes, ".npz")

    def _hold(self, key: str, descriptor: FabricDescriptor) -> None:
        if key in self._memory:
            self._held -= self._memory.pop(key).nbytes
        self._memory[key] = descriptor
        self._held += descriptor.nbytes
        most = len(self._memory) if self.folder is None else self.most
        while len(self._memory) > most or (self._held > self.memory_bytes and len(self._memory) > 1):
            self._held -= self._memory.popitem(last=False)[1].nbytes
