"""Is a store what it says it is: schema, checksums, every sample exactly once."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from renderer.store import RowStatus, ShardRows, Store
from renderer.store_format import array_specs, combine_digests
from renderer.store_location import lost_attributes
from services.dataset.configuration import simulation_seed
from simcore.cores import usable_cores
from simcore.errors import StoreError

MOST_FAULTS = 100
"""Faults that are listed; a damaged store is damaged."""

MOST_THREADS = 8


@dataclass(frozen=True)
class ValidationReport:
    """What was found.

    Attributes:
        valid: nothing is wrong and nothing missing.
        samples, shards: of the store.
        shards_complete: shards with a completion mark.
        faults: what is wrong, one line each, the first hundred.
    """

    valid: bool
    samples: int
    shards: int
    shards_complete: int
    faults: list[str]


def validate_store(
    store: Store, listen: Callable[[int], None] = lambda shard: None, *, threads: int | None = None
) -> ValidationReport:
    """Read every stored object of every shard and check it; ends early once :data:`MOST_FAULTS` are found.

    Args:
        store: which.
        listen: called after each shard.
        threads: shards read at the same time; None for one a core, 8 at most. Each holds a shard (about 50 MB).
    """
    faults = _schema_faults(store)
    if faults:
        return ValidationReport(False, len(store), store.shards, 0, faults)
    try:
        complete, _ = store.complete, store.checksums
    except StoreError as error:
        return ValidationReport(False, len(store), store.shards, 0, [str(error)])
    together = threads or min(MOST_THREADS, usable_cores())
    with ThreadPoolExecutor(together) as pool:
        for start in range(0, store.shards, together):
            shards = range(start, min(start + together, store.shards))
            for shard, found in zip(
                shards, pool.map(lambda n: _shard_faults(store, n, bool(complete[n])), shards), strict=True
            ):
                faults += found
                listen(shard)
            if len(faults) >= MOST_FAULTS:
                break
    return ValidationReport(not faults, len(store), store.shards, int(complete.sum()), faults[:MOST_FAULTS])


def _schema_faults(store: Store) -> list[str]:
    faults = [f"attribute {name} is missing" for name in lost_attributes(store.attributes)]
    for spec in array_specs(store.layout):
        try:
            array = store.array(spec.name)
        except StoreError as error:
            faults.append(str(error))
            continue
        length = {"sample": len(store), "simulation": store.layout.simulations, "shard": store.shards}[spec.per]
        if array.shape != (length, *spec.item):
            faults.append(f"array {spec.name} has shape {array.shape}, not {(length, *spec.item)}")
        if spec.dtype is not str and array.dtype != np.dtype(spec.dtype):
            faults.append(f"array {spec.name} holds {array.dtype}, not {spec.dtype}")
    return faults


def _shard_faults(store: Store, shard: int, complete: bool) -> list[str]:
    if not complete:
        return [f"shard {shard} is unfinished: complete the store with --resume"]
    faults = checksum_faults(store, shard)
    if faults:
        return faults
    try:
        rows = store.read_shard(shard)
    except StoreError as error:
        return [f"shard {shard}: {error}"]
    return [f"shard {shard}: {fault}" for fault in _row_faults(store, shard, rows)]


def checksum_faults(store: Store, shard: int) -> list[str]:
    """Whether a finished shard's objects are those that were written: what is wrong, one line each."""
    objects = store.stored_bytes(shard)
    missing = [key for key, value in objects.items() if value is None]
    if missing:
        return [f"shard {shard}: {key} is missing" for key in missing]
    digests = [(key, hashlib.sha256(value).digest()) for key, value in objects.items() if value is not None]
    if combine_digests(digests) != store.checksums[shard].tobytes():
        return [f"shard {shard}: checksum does not match what is stored"]
    return []


def _row_faults(store: Store, shard: int, rows: ShardRows) -> list[str]:
    """Whether the rows are the ones that belong there, each once and in order."""
    expected = store.layout.columns(store.rows(shard))
    if "merged" not in store.stated["configuration"]:
        seed = int(store.stated["seed"])
        triples = zip(expected["material"], expected["scene"], expected["jitter"], strict=True)
        expected["seed"] = np.array([simulation_seed(seed, triple) for triple in triples], dtype=np.uint64)
    faults = [
        f"column {name} is not that of its rows"
        for name, want in expected.items()
        if (getattr(rows, name) != want).any()
    ]
    if (rows.status == RowStatus.MISSING).any() or (rows.status > max(RowStatus)).any():
        faults.append("a row has no known status")
    failed = rows.status != RowStatus.OK
    if any(not reason for reason in rows.reason[failed]):
        faults.append("a failed row has no reason")
    seen = rows.depth.reshape(len(rows.depth), -1).any(axis=1)
    if (seen == failed).any():
        faults.append("a usable row has an empty picture, or a failed one has a picture")
    return faults
