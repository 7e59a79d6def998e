"""Pictures of `stretch` that look more like the training pictures in the mirror.

The bottom right corner alone is pulled. A picture of the left one pulled, or one that is mirrored, is like nothing that
the network learnt from and gives estimates that are wrong several times over, while its score is about at the border.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simcore.scenes import Scene

BETTER_SHARE = 0.8
"""A picture whose score in the mirror is below this share of its own fits better there. No picture of the open sets
has less than 0.99 as it was taken."""


def fits_better_in_the_mirror(scores: ArrayLike, mirrored: ArrayLike) -> NDArray[np.bool_]:
    """Which pictures do.

    Args:
        scores: outlier scores of the pictures as they are, 1 at the border, shape [pictures].
        mirrored: of their mirror images, same shape; where neither is finite, nothing is said.

    Returns:
        bool, shape [pictures].
    """
    return np.asarray(mirrored, dtype=np.float64) < BETTER_SHARE * np.asarray(scores, dtype=np.float64)


def mirror_reason(scene: Scene, better: ArrayLike) -> str | None:
    """In words, which pictures of a scene fit better in the mirror, bool [pictures]; None where none does."""
    which = np.flatnonzero(better)
    if not len(which):
        return None
    numbers = ", ".join(str(k + 1) for k in which)
    return (
        f"picture {numbers} of {np.size(better)} of {scene.value} fits better in the mirror: check that the bottom "
        "right corner was pulled, not the left one, and that the picture is not mirrored"
    )
