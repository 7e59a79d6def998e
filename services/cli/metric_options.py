"""What the commands of the metric share."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from simcore.errors import InputError

if TYPE_CHECKING:
    from metric.descriptor import DescriptorStore
    from metric.feature_cache import FeatureCache
    from metric.render_cache import RenderCache


def caches(keep: bool) -> tuple[RenderCache | None, FeatureCache]:
    """Caches of renders (on disk) and features (in memory and on disk); memory alone where nothing is to be kept."""
    from metric.feature_cache import FeatureCache
    from metric.render_cache import RenderCache, default_cache_folder

    if not keep:
        return None, FeatureCache()
    folder = make_folder(default_cache_folder(), "set DRAPEMETER_CACHE to another, or give --no-cache")
    return RenderCache(folder / "renders"), FeatureCache(folder / "features")


def check_resolution(resolution_m: float) -> None:
    """Refuse a resolution that does not cut the sample into whole cells, before anything is simulated.

    Raises:
        InputError: it does not.
    """
    from simcore.mesh import GridMesh

    GridMesh(resolution_m)


def make_folder(folder: Path, otherwise: str) -> Path:
    """Make a folder for results before the work that fills it.

    Args:
        folder: the folder.
        otherwise: what to do if it cannot be made, for the message.

    Raises:
        InputError: it cannot be made or written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder} cannot be made ({error.strerror}): {otherwise}", code="folder_unusable") from None
    if not os.access(folder, os.W_OK):
        raise InputError(f"{folder} cannot be written to: {otherwise}", code="folder_unusable")
    return folder


def check_figure(path: Path) -> None:
    """Refuse a figure that could not be written later.

    Raises:
        InputError: another kind of file than PNG, PDF or SVG, or a folder that cannot be made.
    """
    if path.suffix.lower() not in {".png", ".pdf", ".svg"}:
        raise InputError(f"{path}: name a .png, .pdf or .svg file", code="figure_form")
    make_folder(path.absolute().parent, "name a place that can be written to")


def unit_text(unit: str) -> str:
    """A unit as it follows a number."""
    return f" {unit}" if unit else ""


def descriptor_store(keep: bool) -> DescriptorStore:
    """Where a library's sketches are kept; memory alone where nothing is to be kept."""
    from metric.descriptor import DescriptorStore
    from metric.render_cache import default_cache_folder

    return DescriptorStore(default_cache_folder() / "descriptors" if keep else None)
