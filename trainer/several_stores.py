"""Training pictures out of several stores: sweeps that cannot be merged, as their meshes are not alike."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from renderer.store_location import is_remote, local_path
from simcore.errors import InputError
from trainer.config import Inclinations
from trainer.dataset import PictureTable
from trainer.store_source import StoreSource, one_number_a_fabric


class SeveralStores:
    """Stores one after the other as one picture source; a fabric that several hold is one material.

    Args:
        urls: the stores, each once.
        inclinations: see :class:`~trainer.config.TrainConfig`.

    Raises:
        InputError: a store is named twice.
    """

    def __init__(self, urls: Sequence[str], inclinations: Inclinations = "registered") -> None:
        places = [_place(url) for url in urls]
        twice = next((url for n, url in enumerate(urls) if places[n] in places[:n]), None)
        if twice is not None:
            raise InputError(f"{twice} is named twice: give each --store once", code="store_twice")
        self._sources = tuple(StoreSource(url, inclinations) for url in urls)

    def __getstate__(self) -> dict[str, Any]:
        return {"_sources": self._sources}

    @cached_property
    def _first_rows(self) -> NDArray[np.int64]:
        """The first row of each store among all, int64 [stores]."""
        return np.cumsum([0, *(len(source.store) for source in self._sources[:-1])])

    def provenance(self) -> dict[str, Any]:
        """What the stores say of themselves, in the form of a store that they were merged into."""
        said = [source.provenance() for source in self._sources]
        configuration = {
            "merged": [one["configuration"] for one in said],
            "merged_versions": [one["software_version"] for one in said],
        }
        return {"schema": said[0]["schema"], "configuration": configuration, "seed": said[0]["seed"]}

    def table(self) -> PictureTable:
        """Every usable picture; rows, shards and materials are numbered on from store to store.

        Raises:
            InputError: a store has none.
            StoreError: a store is damaged.
        """
        tables, shards, materials = [], 0, 0
        for source, first in zip(self._sources, self._first_rows, strict=True):
            own = source.table()
            tables.append(
                replace(own, row=own.row + first, shard=own.shard + shards, material=own.material + materials)
            )
            shards += source.store.shards
            materials += source.store.layout.materials
        joined = {f.name: np.concatenate([getattr(one, f.name) for one in tables]) for f in fields(PictureTable)}
        return PictureTable(**joined | {"material": one_number_a_fabric(joined["material"], joined["parameters"])})

    def read(self, rows: NDArray[np.int64]) -> Tensor:
        """As :meth:`StoreSource.read`, of the store that holds these rows of one shard."""
        place = int(np.searchsorted(self._first_rows, rows[0], side="right")) - 1
        return self._sources[place].read(rows - self._first_rows[place])


def _place(url: str) -> str:
    """Where a store lies, however it is spelled."""
    return url.rstrip("/") if is_remote(url) else str(local_path(url).resolve())


def open_stores(urls: Sequence[str], inclinations: Inclinations = "registered") -> StoreSource | SeveralStores:
    """One store, or several as one source.

    Raises:
        InputError: a store is named twice.
    """
    return StoreSource(urls[0], inclinations) if len(urls) == 1 else SeveralStores(urls, inclinations)
