"""Training pictures out of a Zarr store."""

from __future__ import annotations

from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import ndimage
from torch import Tensor

from capture.normalise import fill_holes
from renderer.camera import CANONICAL_CAMERA, frontal_pose
from renderer.depth import panel_depth
from renderer.pose import inclination_pose
from renderer.store import RowStatus, Store
from renderer.store_format import SCENE_NAMES
from simcore.errors import InputError, StoreError
from simcore.scenes import Scene
from trainer.config import Inclinations
from trainer.dataset import SCENES, PictureTable
from trainer.preprocess import FLOOR_M

_COUNTS_PER_M = 1e4
_SPARSE = 0.25
"""Below this share of a shard's rows, pictures are read one by one."""


class StoreSource:
    """A store as a picture source. Cheap to pickle: a worker opens the store itself.

    Args:
        url: the store.
        inclinations: see :class:`~trainer.config.TrainConfig`.

    Raises:
        InputError: no store there, or none of its pictures is usable.
        StoreError: no store of this schema.
    """

    def __init__(self, url: str | Path, inclinations: Inclinations = "registered") -> None:
        self.url, self.inclinations = str(url), inclinations

    def __getstate__(self) -> dict[str, Any]:
        return {"url": self.url, "inclinations": self.inclinations}

    @cached_property
    def store(self) -> Store:
        """The open store of this process."""
        return Store.open(self.url)

    def provenance(self) -> dict[str, Any]:
        """What the store says of itself, for the model's record."""
        attributes = dict(self.store.attributes)
        return {key: attributes.get(key) for key in ("schema", "configuration", "seed", "software_version")}

    def table(self) -> PictureTable:
        """Every picture of a simulation that came to rest, of finished shards.

        Raises:
            InputError: there is none.
            StoreError: a column is not that of its rows: one of its objects is lost, or damaged.
        """
        store = self.store
        shard = np.arange(len(store)) // store.layout.rows_per_shard
        usable = np.flatnonzero(store.ok)
        _check_columns(store, usable)
        if not len(usable):
            raise InputError(
                f"{self.url}: not one usable picture in {len(store)} rows; see `drapemeter dataset inspect`",
                code="store_empty",
            )
        order = np.array([SCENES.index(Scene(SCENE_NAMES[code])) for code in range(len(SCENE_NAMES))])
        parameters = store.parameters[usable].astype(np.float64)
        return PictureTable(
            row=usable,
            shard=shard[usable],
            material=one_number_a_fabric(store.materials[usable].astype(np.int64), parameters),
            scene=order[store.scene_codes[usable]],
            parameters=parameters,
            inclination_deg=store.inclination_deg[usable].astype(np.float64),
            jitter=store.jitter[usable].astype(np.int64),
        )

    def read(self, rows: NDArray[np.int64]) -> Tensor:
        """Heights over the panel, int16 in 0.1 mm, shape [rows, 256, 256]; rows of one shard; small holes closed."""
        store = self.store
        span = store.rows(int(rows[0]) // store.layout.rows_per_shard)
        if len(rows) < _SPARSE * len(span):
            counts = store.depth_counts_of(rows)
        else:
            counts = store.depth_counts(int(rows[0]) // store.layout.rows_per_shard)[rows - span.start]
        blank = np.flatnonzero(~counts.reshape(len(counts), -1).any(axis=1))
        if len(blank):
            raise StoreError(
                f"{self.url}: row {int(rows[blank[0]])} has no picture: see `drapemeter dataset validate`",
                code="store_damaged",
            )
        heights = np.empty(counts.shape, dtype=np.int16)
        tilts = store.inclination_deg[rows]
        for tilt in np.unique(tilts):
            here = tilts == tilt
            heights[here] = _heights(counts[here], float(tilt), self.inclinations == "as_seen")
        for picture in np.flatnonzero((counts == 0).any(axis=(1, 2))):  # a sensor's holes, closed as a capture's are
            seen, known = heights[picture].astype(np.float32), counts[picture] > 0
            heights[picture] = np.rint(fill_holes(seen, known, 1.0 / _COUNTS_PER_M)[0])
        return torch.from_numpy(heights)


def _check_columns(store: Store, usable: NDArray[np.int64]) -> None:
    """Refuse a store that has lost small objects, which Zarr reads as zeros.

    Raises:
        StoreError: a row of a finished shard has no status, or a usable one another place or fabric than it can have.
    """
    parameters = store.parameters[usable]
    wrong = {
        "status": np.flatnonzero(store.finished & (store.status == RowStatus.MISSING)),
        "parameters": usable[~(np.isfinite(parameters) & (parameters > 0)).all(axis=1)],
    }
    stored: dict[str, NDArray[Any]] = {
        "material": store.materials,
        "scene": store.scene_codes,
        "jitter": store.jitter,
        "inclination_deg": store.inclination_deg,
    }
    wrong |= {name: usable[stored[name][usable] != want] for name, want in store.layout.columns(usable).items()}
    for name, rows in wrong.items():
        if len(rows):
            raise StoreError(
                f"{store.url}: shard {int(rows[0]) // store.layout.rows_per_shard}: column {name} is not that of its "
                "rows: see `drapemeter dataset validate`, and make the shard again",
                code="store_damaged",
            )


def one_number_a_fabric(material: NDArray[np.int64], parameters: NDArray[np.float64]) -> NDArray[np.int64]:
    """Material numbers, one where a sweep lists a fabric twice or merged stores share it: the first with its seven
    parameters. Else it could be learnt from under one number and tested on under the other.
    """
    _, first, fabric = np.unique(parameters, axis=0, return_index=True, return_inverse=True)
    return np.asarray(material[first][fabric.reshape(-1)])


def _heights(counts: NDArray[Any], inclination_deg: float, as_seen: bool) -> NDArray[np.int16]:
    """Depth counts [n, H, W] to heights over the panel, however it is tilted, in the perspective of that view.

    Only the panel's depth is taken off each pixel; a real capture is drawn anew, as the upright view shows it
    (:func:`capture.normalise.normalise_depth`). Tilted by 5 degrees, the sample is about 2.5 % shorter or longer in the
    picture, its hem 5 % narrower or wider.

    Where the slope is to be seen, it is added where cloth stands off that panel, and only upwards: what leans away
    from the camera would otherwise lie lower than an upright panel and be taken for it.
    """
    panel = _panel_counts(inclination_deg)
    height = np.subtract(panel, counts, dtype=np.float32)
    height[counts == 0] = 0.0
    if as_seen and inclination_deg:
        slope = _panel_counts(0.0) - panel
        cloth = ndimage.uniform_filter(height, (0, 3, 3)) > FLOOR_M * _COUNTS_PER_M
        height = np.where(cloth & (counts > 0), height + (slope - min(0.0, float(slope.min()))), np.float32(0.0))
    rounded: NDArray[np.int16] = np.rint(height).astype(np.int16)
    return rounded


@cache
def _panel_counts(inclination_deg: float) -> NDArray[np.float32]:
    """Depth of the inclined panel in the canonical camera, in counts, float32 [256, 256]."""
    pose = frontal_pose() @ inclination_pose(inclination_deg)
    return np.asarray(panel_depth(CANONICAL_CAMERA, pose) * np.float32(_COUNTS_PER_M), dtype=np.float32)
