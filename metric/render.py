"""What the metric compares: pictures of one drape, checked once."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from renderer.camera import CANONICAL_CAMERA, Camera
from simcore.errors import InputError

SMALLEST_SIDE = 32
"""Pictures smaller than this [pixel] carry no drape."""


@dataclass(frozen=True)
class DrapeRender:
    """Pictures of one drape from one camera; either may be absent where no back end needs it.

    Attributes:
        shaded: grey Lambertian picture, uint8, shape [H, W] (or [H, W, 3] for photographs); black background.
        depth: z-depth of the cloth alone [m], float32, shape [H, W]; 0 where there is no cloth.
        camera: the camera of both pictures.
        panel_depth_m: depth of the panel plane behind the cloth [m] (the pose is frontal).
    """

    shaded: NDArray[np.uint8] | None = None
    depth: NDArray[np.float32] | None = None
    camera: Camera = CANONICAL_CAMERA
    panel_depth_m: float = 0.9

    def __post_init__(self) -> None:
        if self.shaded is None and self.depth is None:
            raise InputError("a drape render needs a shaded or a depth picture", code="render_empty")
        if self.shaded is not None:
            check_picture(self.shaded)
        if self.depth is not None:
            check_depth(self.depth)
        if self.shaded is not None and self.depth is not None and self.shaded.shape[:2] != self.depth.shape:
            raise InputError(
                f"the shaded picture {self.shaded.shape[:2]} and the depth picture {self.depth.shape} differ in size: "
                "render both with one camera",
                code="image_size",
            )

    @cached_property
    def shaded_key(self) -> str:
        """Content hash of the shaded picture."""
        return content_key(self.need_shaded())

    @cached_property
    def depth_key(self) -> str:
        """Content hash of the depth picture."""
        return content_key(self.need_depth())

    @cached_property
    def mask(self) -> NDArray[np.bool_]:
        """Where the cloth is, bool, shape [H, W]."""
        return self.need_depth() > 0

    @cached_property
    def height(self) -> NDArray[np.float32]:
        """Height of the cloth over the panel [m], float32, shape [H, W]; 0 where there is no cloth."""
        depth = self.need_depth()
        return np.where(depth > 0, self.panel_depth_m - depth, 0.0).astype(np.float32)

    def need_shaded(self) -> NDArray[np.uint8]:
        """The shaded picture.

        Raises:
            InputError: there is none.
        """
        if self.shaded is None:
            raise InputError(
                "this back end compares shaded pictures and the render has none: render with shading, "
                "or choose a depth back end (--backend depth)",
                code="render_lacks_shaded",
            )
        return self.shaded

    def need_depth(self) -> NDArray[np.float32]:
        """The depth picture.

        Raises:
            InputError: there is none.
        """
        if self.depth is None:
            raise InputError(
                "this back end compares depth pictures and the render has none: render depth, "
                "or choose a picture back end (--backend lpips)",
                code="render_lacks_depth",
            )
        return self.depth


def content_key(array: NDArray[np.generic]) -> str:
    """sha256 of an array's type, shape and values, hexadecimal."""
    digest = hashlib.sha256(f"{array.dtype.str}{array.shape}".encode())
    digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def check_picture(picture: NDArray[np.generic]) -> None:
    """Refuse what is no 8-bit picture with something in it.

    Raises:
        InputError: not uint8, not [H, W] or [H, W, 3], too small, or constant.
    """
    if picture.dtype != np.uint8:
        raise InputError(
            f"a shaded picture must be uint8 from 0 to 255, got {picture.dtype}: scale and round it first",
            code="image_range",
        )
    if picture.ndim not in (2, 3) or (picture.ndim == 3 and picture.shape[2] != 3):
        raise InputError(
            f"a shaded picture must have shape [H, W] or [H, W, 3], got {list(picture.shape)}", code="image_channels"
        )
    _check_size(picture)
    if int(picture.min()) == int(picture.max()):
        raise InputError(
            f"the shaded picture is constant (every pixel {int(picture.flat[0])}): nothing was rendered",
            code="image_constant",
        )


def check_depth(depth: NDArray[np.generic]) -> None:
    """Refuse what is no depth picture with cloth in it.

    Raises:
        InputError: not float32 [H, W], not finite, negative, too small, or without cloth.
    """
    if depth.ndim != 2:
        raise InputError(f"a depth picture must have shape [H, W], got {list(depth.shape)}", code="image_channels")
    if depth.dtype != np.float32:
        raise InputError(f"a depth picture must be float32 in metres, got {depth.dtype}", code="image_range")
    _check_size(depth)
    values = depth.astype(np.float64)
    if not np.isfinite(values).all():
        raise InputError("the depth picture holds NaN or infinity: use 0 for no data", code="image_not_finite")
    if values.min() < 0 or values.max() > 100.0:
        raise InputError("depth must be in metres, from 0 (no data) to 100", code="image_range")
    if not (values > 0).any():
        raise InputError("the depth picture is empty: no cloth was seen", code="image_constant")


def check_same_size(shapes: list[tuple[int, ...]]) -> None:
    """Refuse pictures of different size.

    Raises:
        InputError: they differ.
    """
    sizes = sorted({shape[:2] for shape in shapes})
    if len(sizes) > 1:
        text = " and ".join(f"{w} x {h}" for h, w in sizes)
        raise InputError(
            f"pictures of different size cannot be compared ({text}): render both with one camera", code="image_size"
        )


def _check_size(picture: NDArray[np.generic]) -> None:
    if min(picture.shape[:2]) < SMALLEST_SIDE:
        raise InputError(
            f"a picture of {picture.shape[1]} x {picture.shape[0]} is too small: give at least {SMALLEST_SIDE} a side",
            code="image_size",
        )
