"""Peak signal-to-noise ratio as a distance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from metric.backends import Channel
from metric.euclidean import squared_distance_table
from metric.render import DrapeRender, check_same_size
from simcore.errors import InputError

CEILING_DB = 60.0
"""PSNR at and above which two 8-bit pictures count as the same [dB]: rounding to 8 bits alone costs 59 dB."""


class Psnr:
    """60 dB - PSNR of the 8-bit pictures [dB]; 0 for the same picture."""

    name = "psnr"
    channel = Channel.SHADED
    unit = "dB"
    fingerprint = "psnr/1"

    def features(self, renders: Sequence[DrapeRender]) -> list[NDArray[np.float32]]:
        """Pixels in [0, 1] over the root of their number, shape [D]: squared distances are mean squared errors."""
        check_same_size([r.need_shaded().shape for r in renders])
        return [(r.need_shaded().astype(np.float32) / 255.0).ravel() / r.need_shaded().size ** 0.5 for r in renders]

    def table(self, a: Sequence[NDArray[np.float32]], b: Sequence[NDArray[np.float32]]) -> NDArray[np.float64]:
        """60 dB - PSNR of every pair, shape [len(a), len(b)]."""
        if len({f.size for f in (*a, *b)}) > 1:
            raise InputError(
                "pictures of different size, or grey and coloured ones, cannot be compared: render all with one camera",
                code="image_size",
            )
        mse = squared_distance_table(a, b)
        decibel = -10.0 * np.log10(np.maximum(mse, 10.0 ** (-CEILING_DB / 10.0)))
        table: NDArray[np.float64] = CEILING_DB - decibel
        return table
