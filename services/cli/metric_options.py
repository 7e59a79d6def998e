"""What the commands of the metric share."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from metric.descriptor import DescriptorStore
    from metric.feature_cache import FeatureCache
    from metric.render_cache import RenderCache


def caches(keep: bool) -> tuple[RenderCache | None, FeatureCache]:
    """Caches of renders (on disk) and features (in memory and on disk); memory alone where nothing is to be kept."""
    from metric.feature_cache import FeatureCache
    from metric.render_cache import RenderCache, default_cache_folder
    from services.cli.outputs import make_folder

    place = default_cache_folder()
    if not keep or place is None:
        return None, FeatureCache()
    folder = make_folder(place, "set DRAPEMETER_CACHE to another, or give --no-cache")
    return RenderCache(folder / "renders"), FeatureCache(folder / "features")


def check_resolution(resolution_m: float) -> None:
    """Refuse a resolution that does not cut the sample into whole cells, before anything is simulated.

    Raises:
        InputError: it does not.
    """
    from simcore.mesh import GridMesh

    GridMesh(resolution_m)


def unit_text(unit: str) -> str:
    """A unit as it follows a number."""
    return f" {unit}" if unit else ""


def descriptor_store(keep: bool) -> DescriptorStore:
    """Where a library's sketches are kept; memory alone where nothing is to be kept."""
    from metric.descriptor import DescriptorStore
    from metric.render_cache import default_cache_folder

    place = default_cache_folder()
    return DescriptorStore(place / "descriptors" if keep and place is not None else None)
