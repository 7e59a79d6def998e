"""Recording: many frames of a still scene become one depth picture of a capture set."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path

import numpy as np

from capture.addition import FOLDER_IN_USE, LOCK_FILE, NewCapture, taken_for_granted, with_capture
from capture.capture_set import CAPTURES_FILE, picture_path, write_captures_json
from capture.sources import DepthSource, Frame
from renderer.camera import Camera
from renderer.picture import write_png
from simcore.errors import InputError

LOCK_WAIT_S = 60.0
"""So long another process may take to add its capture [s]."""
MOST_MOVED_M, MOVED_SHARE = 0.01, 0.05
"""Frames of a still scene differ by less than this [m] in all but this share of the picture."""
MIN_SHARE_OF_FRAMES = 0.5
"""A pixel counts as seen where at least this share of the frames saw it."""


def temporal_median(frames: Iterable[Frame]) -> Frame:
    """Median over time of the pixels with data, uint16 [H, W]; 0 where too few frames have data.

    Raises:
        InputError: ``no_frames``, or frames of different size.
    """
    taken = list(frames)
    if not taken:
        raise InputError("the source gave no depth frame: check that it has a depth stream", code="no_frames")
    if len({frame.shape for frame in taken}) != 1:
        raise InputError("the source's frames differ in size: take them with one camera mode", code="frames_differ")
    stack = np.sort(np.stack(taken), axis=0)  # no data first
    seen = np.count_nonzero(stack, axis=0)
    middle = len(taken) - 1 - seen // 2  # of the last ``seen`` entries the lower median: a value that was measured
    median = np.take_along_axis(stack, np.clip(middle, 0, len(taken) - 1)[None], axis=0)[0]
    return np.where(seen >= max(1.0, MIN_SHARE_OF_FRAMES * len(taken)), median, 0).astype(np.uint16)


def record_capture(
    source: DepthSource,
    folder: str | Path,
    new: NewCapture,
    *,
    frames: int = 30,
    tell: Callable[[str], None] | None = None,
) -> str:
    """Add a capture to a set, which is made if it is not there, and return the capture's id.

    The picture is written first and ``captures.json`` last, each whole or not at all: an interrupted recording leaves
    the set as it was. Several processes may add to one set at once.

    Args:
        source: where the frames come from.
        folder: the capture set.
        new: fabric, scene and what else is said.
        frames: how many frames to take the median of, at most.
        tell: told what of camera and set-up is taken for granted (:func:`capture.addition.taken_for_granted`).

    Raises:
        InputError: no frames, an empty picture, or a set that cannot take the capture.
    """
    folder = Path(folder)
    if frames < 1:
        raise InputError(f"{frames} frames: at least one is needed", code="no_frames")
    check_capture(folder, new, source.camera)
    taken = list(islice(source.frames(), frames))
    counts = temporal_median(taken)
    if not counts.any():
        raise InputError("every pixel of the frames is without data: take them again", code="depth_empty")
    with _alone(folder):
        document = with_capture(folder, new, source.camera)
        added = document.captures[-1]
        picture = picture_path(folder, added.depth, writing=True)
        try:
            write_png(picture, counts)
            write_captures_json(document, folder)
        except BaseException:
            if not _names(folder, added.depth):
                picture.unlink(missing_ok=True)
            raise
    if tell is not None:
        for note in (*taken_for_granted(document, new), *moving(taken, source.camera.depth_unit_m)):
            tell(note)
    return added.id


def _names(folder: Path, picture: str) -> bool:
    """The set that is there names a picture."""
    path = folder / CAPTURES_FILE
    return path.exists() and picture in {entry["depth"] for entry in json.loads(path.read_bytes())["captures"]}


def moving(frames: Sequence[Frame], depth_unit_m: float) -> list[str]:
    """In words, that frames are not of one still scene; nothing of those that are.

    Args:
        frames: uint16 [H, W] each, 0 = no data.
        depth_unit_m: of their counts [m].
    """
    if len(frames) < 2:
        return []
    stack = np.sort(np.stack(frames), axis=0)  # no data first
    count = np.count_nonzero(stack, axis=0)
    stack, count = stack[:, kept := count >= MIN_SHARE_OF_FRAMES * len(frames)], count[kept]
    if not count.size:
        return []
    # a fifth of the frames may be beside the others: flying pixels, not cloth that moves
    first, cut = len(frames) - count, count // 5
    low, high = (np.take_along_axis(stack, at[None], axis=0)[0] for at in (first + cut, len(frames) - 1 - cut))
    spread = (high - low) * depth_unit_m
    most = max(MOST_MOVED_M, 6.0 * float(np.median(spread)))
    share = float(np.mean(spread > most))
    if share <= MOVED_SHARE:
        return []
    return [
        f"the frames differ by more than {1e3 * most:.0f} mm in {100 * share:.0f} % of the picture: the cloth swung, "
        "or they are of several captures, which are to be added one by one"
    ]


def check_capture(folder: str | Path, new: NewCapture, camera: Camera) -> None:
    """Find out whether a set can take a capture, before the work of making one; nothing is written.

    Args:
        folder: the capture set, there or not.
        new: fabric, scene and what else is said.
        camera: that will take it.

    Raises:
        InputError: the set cannot be read, says something else of the fabric or the sensor, the folder holds other
            things, or what is said cannot be.
    """
    folder = Path(folder)
    try:
        with_capture(folder, new, camera)
    except InputError as error:
        if error.code != FOLDER_IN_USE or not (folder / LOCK_FILE).exists():
            raise
        with _alone(folder):  # perhaps another process is making the set: its first picture is there, the rest is not
            with_capture(folder, new, camera)


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """No other process adds to the set for the length of the block; its folder is made.

    Raises:
        InputError: the folder cannot be written, or another process does not come to an end.
    """
    from filelock import FileLock, Timeout

    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = FileLock(folder / LOCK_FILE, timeout=LOCK_WAIT_S, mode=0o666)  # whoever may write to the folder may lock
        lock.acquire()
    except Timeout:
        raise InputError(
            f"{folder}: another process has been adding to it for {LOCK_WAIT_S:.0f} s: try again when it is done",
            code="set_busy",
        ) from None
    except OSError as error:
        raise InputError(f"cannot make the folder {folder}: {error.strerror}", code="cannot_write") from None
    try:
        yield
    finally:
        lock.release()
