"""LPIPS (Zhang et al. 2018) with each render's features computed once.

With unit-length channel vectors f at each pixel, LPIPS is a sum over layers of mean_xy sum_c w_c (f_c(a) - f_c(b))².
All w_c are non-negative, so with f scaled by sqrt(w_c / pixels) it is a squared Euclidean distance between two vectors:
the network runs once a render and every pair costs one inner product.
"""

from __future__ import annotations

import copy
import warnings
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from metric.backends import Channel
from metric.euclidean import squared_distance_table
from metric.render import DrapeRender, check_same_size
from metric.weights import LPIPS_HEADS_SHA256, check_hash, load_backbone
from simcore.errors import InputError

if TYPE_CHECKING:
    import torch

_SCALE = 256.0  # keeps scaled features inside float16's normal range
_EPSILON = 1e-10  # lpips.normalize_tensor
_SMALLEST = 64
_BATCH = 2  # larger batches leave the processor's cache and are slower


class LpipsBackend:
    """LPIPS, version 0.1, with the lpips package's linear heads.

    Args:
        net: trunk, ``squeeze``, ``alex`` or ``vgg``.

    Raises:
        InputError: another trunk.
        MissingResourceError: its weights are not here and cannot be downloaded.
    """

    channel = Channel.SHADED
    unit = ""
    squared_distance_unit = 1.0 / _SCALE**2

    def __init__(self, net: str = "squeeze") -> None:
        if net not in LPIPS_HEADS_SHA256:
            raise InputError(
                f"unknown LPIPS trunk {net!r}: choose {', '.join(LPIPS_HEADS_SHA256)}", code="backend_unknown"
            )
        self.net = net
        self.name = f"lpips-{net}"
        self._model, sha256 = _build(net)
        self._net = _channels_last(self._model.net)
        self.fingerprint = f"lpips-0.1/{net}/{sha256[:16]}/{LPIPS_HEADS_SHA256[net][:8]}/f16-hwc"

    @property
    def model(self) -> Any:
        """The lpips package's own module, in evaluation mode."""
        return self._model

    @cached_property
    def _head_roots(self) -> list[torch.Tensor]:
        roots = []
        for head in self._model.lins:
            weight = head.model[-1].weight.detach()
            if bool((weight < 0).any()):
                raise ValueError("LPIPS heads must not be negative")
            roots.append(weight.sqrt())
        return roots

    def features(self, renders: Sequence[DrapeRender]) -> list[NDArray[np.float16]]:
        """Scaled features of each render, float16, shape [D]."""
        import torch

        check_same_size([r.need_shaded().shape for r in renders])
        if not renders:
            return []
        images = np.stack([lpips_range(r.need_shaded()) for r in renders])
        check_lpips_images(images, range_known=True)
        found: list[NDArray[np.float16]] = []
        with torch.inference_mode():
            for start in range(0, len(images), _BATCH):
                batch = torch.from_numpy(np.ascontiguousarray(images[start : start + _BATCH]))
                found.extend(self._embed(batch))
        return found

    def table(self, a: Sequence[NDArray[np.float16]], b: Sequence[NDArray[np.float16]]) -> NDArray[np.float64]:
        """LPIPS of every pair, shape [len(a), len(b)]."""
        lengths = {v.shape for v in (*a, *b)}
        if len(lengths) > 1:
            raise InputError("features of pictures of different size cannot be compared", code="image_size")
        return squared_distance_table(a, b) * self.squared_distance_unit

    def _embed(self, batch: torch.Tensor) -> list[NDArray[np.float16]]:
        import torch

        batch = batch.contiguous(memory_format=torch.channels_last)
        layers = self._net.forward(self._model.scaling_layer(batch))
        sizes = [layer[0].numel() for layer in layers]
        rows = [torch.empty(sum(sizes), dtype=torch.float16) for _ in range(len(batch))]
        start = 0
        for layer, root, size in zip(layers, self._head_roots, sizes, strict=True):
            pixels = layer.shape[2] * layer.shape[3]
            length = layer.square().sum(dim=1, keepdim=True).sqrt_().add_(_EPSILON)
            scaled = layer.div_(length).mul_(root * (_SCALE / pixels**0.5))
            for row, values in zip(rows, scaled, strict=True):
                row[start : start + size].copy_(values.permute(1, 2, 0).reshape(-1))
            start += size
        return [row.numpy() for row in rows]


def lpips_range(picture: NDArray[np.uint8]) -> NDArray[np.float32]:
    """8-bit grey [H, W] or colour [H, W, 3] to float32 [3, H, W] from -1 to 1, as LPIPS expects."""
    colour = picture if picture.ndim == 3 else np.repeat(picture[:, :, None], 3, axis=2)
    scaled: NDArray[np.float32] = (colour.astype(np.float32) / 127.5 - 1.0).transpose(2, 0, 1)
    return scaled


def check_lpips_images(images: NDArray[Any], *, range_known: bool = False) -> None:
    """Refuse what LPIPS would take without a word and measure wrongly.

    Args:
        images: to be compared.
        range_known: they were scaled here, so that one with nothing below 0 is a bright picture.

    Raises:
        InputError: not [N, 3, H, W], below 64 pixels, outside [-1, 1], in [0, 1], constant or not finite.
    """
    if images.ndim != 4 or images.shape[1] != 3:
        raise InputError(
            f"LPIPS takes images of shape [N, 3, H, W], got {list(images.shape)}: repeat a grey picture three times",
            code="image_channels",
        )
    if min(images.shape[2:]) < _SMALLEST:
        raise InputError(f"LPIPS needs pictures of at least {_SMALLEST} pixels a side", code="image_size")
    if images.dtype != np.float32:
        raise InputError(f"LPIPS takes float32 from -1 to 1, got {images.dtype}", code="image_range")
    if not np.isfinite(images).all():
        raise InputError("a picture holds NaN or infinity", code="image_not_finite")
    low, high = images.min(axis=(1, 2, 3)), images.max(axis=(1, 2, 3))
    if (low == high).any():
        raise InputError("a picture is constant: nothing was rendered", code="image_constant")
    if low.min() < -1.0 or high.max() > 1.0:
        raise InputError(
            f"LPIPS takes values from -1 to 1, got {low.min():g} to {high.max():g}: map [0, 255] by x / 127.5 - 1",
            code="image_range",
        )
    if (low >= 0.0).any() and not range_known:
        raise InputError(
            "LPIPS takes values from -1 to 1 and a picture has none below 0, as if it were in [0, 1]: map it by 2x - 1",
            code="image_range",
        )


def _channels_last(net: Any) -> Any:
    """A copy of the trunk laid out so that a processor convolves it twice as fast."""
    import torch

    return copy.deepcopy(net).to(memory_format=torch.channels_last)


def _build(net: str) -> tuple[Any, str]:
    from renderer.torchvision_import import import_torchvision

    import_torchvision()
    import lpips

    state, sha256 = load_backbone(net)
    heads = Path(lpips.__file__).parent / "weights" / "v0.1" / f"{net}.pth"
    check_hash(heads, LPIPS_HEADS_SHA256[net])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # lpips calls torchvision by its old argument names
        model = lpips.LPIPS(net=net, pnet_rand=True, verbose=False)
    # lpips cuts the trunk into slices that keep torchvision's layer numbers: slice2.3.weight is torchvision's 3.weight
    names = {name.split(".", 1)[1]: name for name in model.net.state_dict()}
    model.net.load_state_dict({names[k]: v for k, v in state.items() if k in names}, strict=True)
    model.eval()
    return model, sha256
