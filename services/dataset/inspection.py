"""What a store holds, in numbers."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from renderer.store import RowStatus, Store
from simcore.parameters import PARAMETER_NAMES

MOST_REASONS = 20


@dataclass(frozen=True)
class StoreReport:
    """Numbers of a store.

    Attributes:
        samples, materials, jitters, inclinations: counts.
        scenes: scene names.
        shards, shards_complete: shards in all, and those with a completion mark.
        ok: usable samples.
        failed: failed samples by status.
        reasons: failed samples by the reason as it was written, the most frequent ones.
        ranges: lowest and highest value of each parameter among the finished samples, SI.
        stored_bytes: size of the finished shards' objects.
        bytes_per_picture: stored bytes of a usable depth picture, and how many times smaller than float32.
        configuration, seed, software_version: as stored.
    """

    samples: int
    materials: int
    jitters: int
    inclinations: int
    scenes: list[str]
    shards: int
    shards_complete: int
    ok: int
    failed: dict[str, int]
    reasons: dict[str, int]
    ranges: dict[str, tuple[float, float]]
    stored_bytes: int
    bytes_per_picture: float
    float32_ratio: float
    configuration: dict[str, object]
    seed: int
    software_version: str


def inspect_store(store: Store) -> StoreReport:
    """Count and measure a store, finished or not."""
    layout = store.layout
    finished = store.finished
    failed = finished & (store.status != RowStatus.OK)
    codes, counts = np.unique(store.status[failed], return_counts=True)
    parameters = store.parameters[finished]
    sizes = store.object_sizes()
    usable = int(store.ok.sum())
    picture = sizes.get("depth", 0) / usable if usable else 0.0
    picture = picture or float("nan")  # none is usable, or what should hold them is lost
    return StoreReport(
        samples=len(store),
        materials=layout.materials,
        jitters=layout.jitters,
        inclinations=layout.pictures,
        scenes=list(layout.scenes),
        shards=store.shards,
        shards_complete=int(store.complete.sum()),
        ok=usable,
        failed={RowStatus(int(code)).label: int(count) for code, count in zip(codes, counts, strict=True)},
        reasons=dict(Counter(str(reason) for reason in store.reason[failed]).most_common(MOST_REASONS)),
        ranges={
            name: (float(parameters[:, i].min()), float(parameters[:, i].max()))
            for i, name in enumerate(PARAMETER_NAMES)
            if len(parameters)
        },
        stored_bytes=sum(sizes.values()),
        bytes_per_picture=picture,
        float32_ratio=4.0 * float(np.prod(layout.picture_size)) / picture,
        configuration=dict(store.stated["configuration"]),
        seed=int(store.stated["seed"]),
        software_version=str(store.stated["software_version"]),
    )
