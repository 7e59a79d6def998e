"""The metric's caches: renders, features and sketches by content, in parts of one folder."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from metric.descriptor import DescriptorStore
    from metric.feature_cache import FeatureCache
    from metric.render_cache import RenderCache


@dataclass(frozen=True)
class MetricCaches:
    """What the metric keeps.

    Attributes:
        renders: on disk; None where nothing is kept there.
        features: in memory and on disk.
        descriptors: sketches of whole fabrics, in memory and on disk.
    """

    renders: RenderCache | None
    features: FeatureCache
    descriptors: DescriptorStore


def metric_caches(folder: Path | None) -> MetricCaches:
    """Caches in a folder; in memory alone where it is None."""
    from metric.descriptor import DescriptorStore
    from metric.feature_cache import FeatureCache
    from metric.render_cache import RenderCache

    if folder is None:
        return MetricCaches(None, FeatureCache(), DescriptorStore())
    return MetricCaches(
        RenderCache(folder / "renders"), FeatureCache(folder / "features"), DescriptorStore(folder / "descriptors")
    )


@cache
def shared_metric_caches() -> MetricCaches:
    """Those that the jobs of this process share, in ``DRAPEMETER_CACHE`` (empty: in memory)."""
    from renderer.user_cache import default_cache_folder

    return metric_caches(default_cache_folder())
