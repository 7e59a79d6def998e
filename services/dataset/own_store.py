"""Whether a store is a sweep's own: of two that begin in one place at one moment, one lays it out over the other."""

from __future__ import annotations

from renderer.store import Store
from renderer.store_format import array_specs, per_shard
from services.dataset.configuration import SweepConfiguration, differences
from simcore.errors import InputError, StoreError


def check_settings(store: Store, configuration: SweepConfiguration) -> None:
    """Refuse a store that states other settings.

    Raises:
        InputError: it does.
        StoreError: it is damaged.
    """
    differing = differences(store.stated["configuration"], configuration)
    if differing:
        raise InputError(
            f"{store.url}: was made with other settings ({', '.join(differing)}); "
            "resume it with its own, or choose another --out",
            code="store_configuration",
        )


def check_shards(store: Store, configuration: SweepConfiguration) -> None:
    """Refuse arrays that another sweep laid out; one that is not there is left to whoever needs it.

    Another driver of the same sweep may be laying it out once more.

    Raises:
        StoreError: one is of another size or has other shards.
    """
    layout = configuration.layout
    lengths = {"sample": layout.samples, "simulation": layout.simulations, "shard": layout.shards}
    for spec in array_specs(layout):
        try:
            array = store.array(spec.name)
        except StoreError:
            continue
        wanted = (lengths[spec.per], *spec.item), per_shard(spec, layout)
        if (array.shape, (array.shards or array.chunks)[0]) != wanted:
            raise StoreError(
                f"{store.url}: two sweeps laid it out at the same moment; remove it, and start one of them again",
                code="store_layout",
            )
