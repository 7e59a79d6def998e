"""What a picture that is stretched or sheared changes: any linear error of a lens or of its calibration."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from diagnosis.measurement.features import measure
from diagnosis.measurement.reference import Reference
from diagnosis.simulation.variations import clean
from renderer.camera import Camera

Mask = NDArray[np.bool_]
WARP = 0.01
"""Share by which a picture is stretched along rows or columns, or sheared along either."""
DIRECTIONS = np.eye(4).reshape(4, 2, 2)


def warp_responses(reference: Reference, camera: Camera) -> NDArray[np.float64]:
    """What changes when a picture is warped by :data:`WARP` about the optical axis [m], each way for itself.

    A picture that shrinks shows the panel where the cloth's rim was; one that grows shows cloth beside it.

    Returns:
        float64 [8, cells + ring + 3]: as :meth:`diagnosis.measurement.features.Features.vector`, four forward, then
        the same four backward; zero where nothing is seen.
    """
    centre = np.array([camera.cy, camera.cx])

    def seen(change: NDArray[np.float64]) -> NDArray[np.float64]:
        picture = warped(reference.depth, np.eye(2) + change, centre)
        return clean(measure(picture, reference, with_pixels=False).vector())

    return np.stack([seen(sign * WARP * way) for sign in (1, -1) for way in DIRECTIONS])


def warped(depth: NDArray[np.float32], matrix: NDArray[np.float64], centre: NDArray[np.float64]) -> NDArray[np.float32]:
    """A picture [m] whose pixel at ``centre + p`` shows what was at ``centre + matrix @ p`` (row, column)."""
    from scipy.ndimage import affine_transform

    offset = centre - matrix @ centre
    values = affine_transform(depth, matrix, offset, order=1)
    known = depth > 0
    if known.all():
        shown = _of_a_full_picture(depth.shape, matrix.tobytes(), offset.tobytes())
    else:
        shown = _still_known(known, matrix, offset)
    return np.where(shown, values, np.float32(0.0))


def _still_known(known: NDArray[np.bool_], matrix: NDArray[np.float64], offset: NDArray[np.float64]) -> Mask:
    from scipy.ndimage import affine_transform

    return np.asarray(affine_transform(known.astype(np.float32), matrix, offset, order=1) > 0.999)


@lru_cache(maxsize=8)
def _of_a_full_picture(shape: tuple[int, int], matrix: bytes, offset: bytes) -> Mask:
    """The same of a picture that has data everywhere: captures of one camera are warped alike."""
    rows, shift = np.frombuffer(matrix).reshape(2, 2), np.frombuffer(offset)
    found = _still_known(np.ones(shape, dtype=bool), rows, shift)
    found.setflags(write=False)
    return found
