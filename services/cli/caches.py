"""The user's caches, in the folder ``DRAPEMETER_CACHE``; one that cannot be used is told before anything is done."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from diagnosis.simulation.drape_cache import DrapeCache
    from services.caches import MetricCaches


def metric_caches(keep: bool | None = None) -> MetricCaches:
    """Caches of the metric; memory alone where nothing is to be kept.

    Args:
        keep: what the command's ``--cache/--no-cache`` says; None for a command without it, which keeps.

    Raises:
        InputError: their folder cannot be used.
    """
    from renderer.user_cache import default_cache_folder
    from services import caches
    from services.cli.outputs import make_folder

    place = None if keep is False else default_cache_folder()
    if place is not None:
        none = "to nothing at all to keep nothing" if keep is None else "give --no-cache"
        make_folder(place, f"set DRAPEMETER_CACHE to another folder, or {none}")
    return caches.metric_caches(place)


def drape_cache() -> DrapeCache:
    """The diagnosis's cache of drapes.

    Raises:
        InputError: its folder cannot be used.
    """
    from diagnosis.simulation.drape_cache import DrapeCache
    from services.cli.outputs import check_folder

    cache = DrapeCache.default()
    if cache.folder is not None:
        check_folder(cache.folder, "set DRAPEMETER_CACHE to another folder, or to nothing at all to keep no drapes")
    return cache
