"""The caches that jobs share: renders and features, by content, in ``DRAPEMETER_CACHE`` (empty: in memory)."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from metric.descriptor import DescriptorStore
    from metric.feature_cache import FeatureCache
    from metric.render_cache import RenderCache


@cache
def render_cache() -> RenderCache | None:
    """Renders on disk."""
    from metric.render_cache import RenderCache

    folder = _folder("renders")
    return RenderCache(folder) if folder is not None else None


@cache
def feature_cache() -> FeatureCache:
    """Features in memory and on disk."""
    from metric.feature_cache import FeatureCache

    return FeatureCache(_folder("features"))


@cache
def descriptor_store() -> DescriptorStore:
    """Sketches of whole fabrics, in memory and on disk."""
    from metric.descriptor import DescriptorStore

    return DescriptorStore(_folder("descriptors"))


def _folder(name: str) -> Path | None:
    """A part of the cache; None where nothing is to be kept on disk."""
    from metric.render_cache import default_cache_folder

    folder = default_cache_folder()
    return folder / name if folder is not None else None
