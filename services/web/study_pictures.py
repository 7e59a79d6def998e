"""Pictures for a human study: renders of simulated fabrics, or photographs that the user supplies."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING
from warnings import catch_warnings

import numpy as np

from metric.library import LibraryFabric
from metric.render_cache import RenderCache
from metric.simulate import SimulationPlan, samples_apart, simulate_fabrics
from services.web.study_create import PictureFile, StudyEntry
from simcore.errors import InputError, SimulationError

if TYPE_CHECKING:
    from PIL import Image

LITTER = frozenset({"Thumbs.db", "desktop.ini", "__MACOSX", "@eaDir"})
"""What file browsers, archives and network drives leave behind, beside what is hidden."""
PHOTOGRAPH_SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".webp"})
OTHER_PICTURES = frozenset({".avif", ".bmp", ".dng", ".gif", ".heic", ".heif", ".tif", ".tiff"})
"""Suffixes of pictures that are not taken."""
LARGEST_SIDE = 1024
_MOST_PIXELS = 100_000_000


def entries_from_library(
    library: Sequence[LibraryFabric],
    plan: SimulationPlan,
    *,
    renders: RenderCache | None = None,
    on_done: Callable[[], None] | None = None,
) -> list[StudyEntry]:
    """Each fabric with shaded renders of all its repeats, both scenes together.

    Raises:
        SimulationError: fabrics that could not be simulated, by name.
    """
    from PIL import Image

    fabrics = [f.parameters for f in library]
    firsts = samples_apart(fabrics, plan)
    simulated = simulate_fabrics(
        fabrics, plan, first_repeats=firsts, cache=renders, keep_failures=True, on_done=on_done
    )
    lost = {fabric.id: found.failure for fabric, found in zip(library, simulated, strict=True) if found.failure}
    if lost:
        first = next(iter(lost))
        raise SimulationError(
            f"{', '.join(lost)} could not be simulated (of {first} {lost[first]}): take them out of the library, or "
            "try another --seed or a finer --resolution",
            code="simulation_not_still",
        )
    entries = []
    for fabric, found in zip(library, simulated, strict=True):
        pictures = []
        for scene, sets in found.scenes.items():
            for repeat, render in enumerate(sets):
                stream = BytesIO()
                Image.fromarray(render.need_shaded()).save(stream, format="PNG", optimize=True)
                pictures.append(PictureFile(repeat, scene.value, "image/png", stream.getvalue()))
        entries.append(StudyEntry(fabric.id, fabric.parameters, tuple(pictures)))
    return entries


def entries_from_photographs(folder: Path, library: Sequence[LibraryFabric] = ()) -> list[StudyEntry]:
    """One fabric a subfolder, its photographs shown together; parameters where the library has a fabric of that name.

    Photographs are turned upright, scaled down to 1024 pixels and stripped of all that a camera writes into them.

    Raises:
        InputError: no such folder, no subfolders or an empty one, pictures beside the subfolders or a folder inside
            one, a file that is no usable picture, or a subfolder of a name that a library, where one is given, does not
            have.
    """
    if not folder.is_dir():
        raise InputError(
            f"{folder}: no such folder; give one with a subfolder of photographs for each fabric", code="file_missing"
        )
    known = {fabric.id: fabric.parameters for fabric in library}
    entries = []
    for inner in _fabric_folders(folder):
        files = _photographs(inner)
        pictures = tuple(
            PictureFile(0, f"{place:04d} {_as_text(path.stem)}"[:80], "image/jpeg", _photograph(path))
            for place, path in enumerate(files)
        )
        entries.append(StudyEntry(inner.name, known.get(inner.name), pictures))
    strange = sorted(entry.name for entry in entries if library and entry.name not in known)
    if strange:
        raise InputError(
            f"{folder}: the library has no fabric named {', '.join(strange)} (it has {', '.join(sorted(known))}): name "
            "subfolders as it names fabrics, or give no library, and no metric is compared with the answers",
            code="photographs_unknown",
        )
    return entries


def _seen(folder: Path) -> list[Path]:
    """What lies in a folder by name, but for what is hidden and litter."""
    return sorted(p for p in folder.iterdir() if not p.name.startswith(".") and p.name not in LITTER)


def _fabric_folders(folder: Path) -> list[Path]:
    """The subfolders by name; other files than pictures beside them are nothing of the study.

    Raises:
        InputError: there are none, or pictures beside them, which are of no fabric.
    """
    seen = _seen(folder)
    found = [p for p in seen if p.is_dir()]
    if not found:
        raise InputError(f"{folder} has no subfolders: put each fabric's photographs into one", code="study_empty")
    loose = [p.name for p in seen if not p.is_dir() and p.suffix.lower() in PHOTOGRAPH_SUFFIXES | OTHER_PICTURES]
    if loose:
        raise InputError(
            f"{folder}: {loose[0]} is in no fabric's subfolder: move it into one, or take it out",
            code="photograph_kind",
        )
    return found


def _photographs(folder: Path) -> list[Path]:
    """The folder's photographs by name.

    Raises:
        InputError: it has none, or a folder, or other files, which may be photographs as well (those of many telephones
            are HEIC).
    """
    files = _seen(folder)
    deeper = [p.name for p in files if p.is_dir()]
    if deeper:
        raise InputError(
            f"{folder}: {deeper[0]} is a folder, and nothing in it would be shown: move its photographs up into "
            f"{folder.name}, or take it out",
            code="photograph_kind",
        )
    others = [p.name for p in files if p.suffix.lower() not in PHOTOGRAPH_SUFFIXES]
    if others:
        raise InputError(
            f"{folder}: {others[0]} is none of {', '.join(sorted(PHOTOGRAPH_SUFFIXES))}: convert it, or take it out",
            code="photograph_kind",
        )
    if not files:
        raise InputError(f"no pictures of {folder.name}: {folder} is empty", code="study_pictures_missing")
    return files


def _in_colour(image: Image.Image) -> Image.Image:
    """Eight bits a channel: what is transparent on white, sixteen bits scaled down, not cut off."""
    from PIL import Image

    if image.mode.startswith(("I", "F")):
        counts = np.asarray(image, dtype=np.float64)
        if image.mode == "F" or counts.min() < 0 or counts.max() > 65535:
            raise OSError(f"its pixels are numbers of kind {image.mode}, from {counts.min():g} to {counts.max():g}")
        return Image.fromarray(np.rint(counts / 257.0).astype(np.uint8)).convert("RGB")
    if image.has_transparency_data:
        white = Image.new("RGBA", image.size, "white")
        return Image.alpha_composite(white, image.convert("RGBA")).convert("RGB")
    return image.convert("RGB")


def _as_text(name: str) -> str:
    """A file's name, what of it is no text written out."""
    return name.encode(errors="backslashreplace").decode()


def _photograph(path: Path) -> bytes:
    from PIL import Image, ImageOps, UnidentifiedImageError

    too_large = InputError(f"{path}: more than 100 megapixels; scale it down", code="photograph_too_large")
    try:
        with catch_warnings(action="ignore", category=Image.DecompressionBombWarning):  # the limit is our own
            image = Image.open(path)
        with image:
            if image.width * image.height > _MOST_PIXELS:
                raise too_large
            upright = _in_colour(ImageOps.exif_transpose(image))
    except Image.DecompressionBombError:
        raise too_large from None
    except (UnidentifiedImageError, OSError, SyntaxError, ValueError) as error:  # the last: too much text in a PNG
        raise InputError(f"{path}: not a usable picture ({error})", code="photograph_unreadable") from None
    upright.thumbnail((LARGEST_SIDE, LARGEST_SIDE))
    clean = Image.new("RGB", upright.size)
    clean.paste(upright)
    stream = BytesIO()
    clean.save(stream, format="JPEG", quality=88)
    return stream.getvalue()
