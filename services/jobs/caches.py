"""The caches that jobs share: renders and features, by content, in ``DRAPEMETER_CACHE``."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from metric.descriptor import DescriptorStore
    from metric.feature_cache import FeatureCache
    from metric.render_cache import RenderCache


@cache
def render_cache() -> RenderCache:
    """Renders on disk."""
    from metric.render_cache import RenderCache, default_cache_folder

    return RenderCache(default_cache_folder() / "renders")


@cache
def feature_cache() -> FeatureCache:
    """Features in memory and on disk."""
    from metric.feature_cache import FeatureCache
    from metric.render_cache import default_cache_folder

    return FeatureCache(default_cache_folder() / "features")


@cache
def descriptor_store() -> DescriptorStore:
    """Sketches of whole fabrics, in memory and on disk."""
    from metric.descriptor import DescriptorStore
    from metric.render_cache import default_cache_folder

    return DescriptorStore(default_cache_folder() / "descriptors")
