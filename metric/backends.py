"""The small interface behind which every way to compare two drapes stands, and its register."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from enum import StrEnum
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from metric.render import DrapeRender
from simcore.errors import InputError

Features = Any
"""What a back end computes once a render; only the back end that made it reads it."""


class Channel(StrEnum):
    """What a back end looks at."""

    SHADED = "shaded"
    DEPTH = "depth"


class Backend(Protocol):
    """One image distance IM(a, b): 0 for the same picture, larger for less alike."""

    @property
    def name(self) -> str:
        """As given to ``--backend``."""
        ...

    @property
    def channel(self) -> Channel:
        """Which picture of a render it reads."""
        ...

    @property
    def unit(self) -> str:
        """Unit of the distance, "" where it has none."""
        ...

    @property
    def fingerprint(self) -> str:
        """Changes whenever the same picture would give other features (weights, version)."""
        ...

    def features(self, renders: Sequence[DrapeRender]) -> list[Features]:
        """One pass over each render, in batches; one entry a render.

        Raises:
            InputError: renders of different size, or without the channel.
        """
        ...

    def table(self, a: Sequence[Features], b: Sequence[Features]) -> NDArray[np.float64]:
        """IM of every pair, float64, shape [len(a), len(b)].

        Raises:
            InputError: features of pictures of different size.
        """
        ...


@runtime_checkable
class SquaredEuclideanBackend(Backend, Protocol):
    """A back end whose features are vectors and whose distance is their squared Euclidean distance."""

    @property
    def squared_distance_unit(self) -> float:
        """IM for a squared distance of 1 between features."""
        ...


def distance(backend: Backend, a: DrapeRender, b: DrapeRender) -> float:
    """IM of one pair of renders.

    Raises:
        InputError: renders of different size, or without the channel.
    """
    first, second = backend.features([a, b])
    return float(backend.table([first], [second])[0, 0])


def _lpips(net: str) -> Callable[[], Backend]:
    def make() -> Backend:
        from metric.lpips_backend import LpipsBackend

        return LpipsBackend(net)

    return make


def _named(module: str, cls: str) -> Callable[[], Backend]:
    def make() -> Backend:
        backend: Backend = getattr(importlib.import_module(f"metric.{module}"), cls)()
        return backend

    return make


_REGISTER: dict[str, Callable[[], Backend]] = {
    "lpips": _lpips("squeeze"),
    "lpips-squeeze": _lpips("squeeze"),
    "lpips-alex": _lpips("alex"),
    "lpips-vgg": _lpips("vgg"),
    "ssim": _named("ssim", "Ssim"),
    "ms-ssim": _named("ssim", "MsSsim"),
    "psnr": _named("psnr", "Psnr"),
    "depth": _named("depth_rmse", "DepthRmse"),
    "silhouette": _named("silhouette", "SilhouetteIou"),
    "normals": _named("normals", "NormalAngle"),
}

BACKEND_NAMES: tuple[str, ...] = tuple(_REGISTER)
"""Names that :func:`get_backend` knows."""


def check_backend(name: str) -> None:
    """Refuse a name that no back end has, without making one.

    Raises:
        InputError: unknown name.
    """
    if name not in _REGISTER:
        raise InputError(f"unknown back end {name!r}: choose one of {', '.join(BACKEND_NAMES)}", code="backend_unknown")


def get_backend(name: str) -> Backend:
    """Make a back end by name.

    Raises:
        InputError: unknown name.
        MissingResourceError: its weights are not on this machine and cannot be downloaded.
    """
    check_backend(name)
    return _REGISTER[name]()
