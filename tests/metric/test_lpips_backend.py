"""LPIPS equals the lpips package, gives the published values, and refuses what the package takes silently."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from metric.backends import distance
from metric.lpips_backend import LpipsBackend, check_lpips_images, lpips_range
from metric.render import DrapeRender
from simcore.errors import InputError


@pytest.fixture(scope="module")
def backend(weights_dir: Path) -> Iterator[LpipsBackend]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DRAPEMETER_WEIGHTS", str(weights_dir))
        yield LpipsBackend("squeeze")


def package_forward(backend: LpipsBackend, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    import torch

    with torch.inference_mode():
        return backend.model(torch.from_numpy(a), torch.from_numpy(b)).numpy().ravel()


def coloured(pictures: np.ndarray) -> list[DrapeRender]:
    """Pictures of random pixels, uint8 [N, H, W, 3], where shaded ones are asked for."""
    return [cast(DrapeRender, SimpleNamespace(need_shaded=lambda picture=picture: picture)) for picture in pictures]


def test_equals_the_package_on_random_pairs(backend: LpipsBackend) -> None:
    pictures = np.random.default_rng(1).integers(0, 256, (6, 96, 80, 3), dtype=np.uint8)
    images = np.stack([lpips_range(picture) for picture in pictures])
    features = backend.features(coloured(pictures))
    table = backend.table(features[:3], features[3:])
    expected = np.array(
        [[package_forward(backend, images[i : i + 1], images[j : j + 1])[0] for j in (3, 4, 5)] for i in range(3)]
    )
    assert np.abs(table - expected).max() < 1e-5


def test_equals_the_package_on_rendered_pairs(backend: LpipsBackend, make_render: Callable[..., DrapeRender]) -> None:
    renders = [make_render(folds=f, phase=p) for f, p in ((2.0, 0.0), (2.0, 0.02), (5.0, 1.0))]
    images = np.stack([lpips_range(r.need_shaded()) for r in renders])
    features = backend.features(renders)
    table = backend.table(features, features)
    for i in range(3):
        for j in range(3):
            assert table[i, j] == pytest.approx(package_forward(backend, images[[i]], images[[j]])[0], abs=1e-5)
    assert table[0, 1] < table[0, 2]


def test_published_doctest_values(backend: LpipsBackend) -> None:
    """torchmetrics' documentation: seed 123, ten pairs of uniform pictures, net squeeze; here of 256 levels."""
    import torch

    torch.manual_seed(123)
    drawn = torch.cat([torch.rand(10, 3, 100, 100), torch.rand(10, 3, 100, 100)])
    features = backend.features(coloured((255.0 * drawn).round().byte().permute(0, 2, 3, 1).numpy()))
    assert np.diag(backend.table(features[:10], features[10:])).mean() == pytest.approx(0.1008, abs=1e-4)


def test_same_picture_is_at_distance_zero(backend: LpipsBackend, make_render: Callable[..., DrapeRender]) -> None:
    assert distance(backend, make_render(), make_render()) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("images", "code"),
    [
        (np.zeros((1, 1, 96, 96), np.float32), "image_channels"),
        (np.zeros((3, 96, 96), np.float32), "image_channels"),
        (np.full((1, 3, 96, 96), 0.5, np.float32), "image_constant"),
        (np.random.default_rng(0).uniform(0, 255, (1, 3, 96, 96)).astype(np.float32), "image_range"),
        (np.random.default_rng(0).uniform(0, 1, (1, 3, 96, 96)).astype(np.float32), "image_range"),
        (np.random.default_rng(0).uniform(-1, 1, (1, 3, 96, 96)), "image_range"),
        (np.where(np.arange(96) == 3, np.nan, np.zeros((1, 3, 96, 96))).astype(np.float32), "image_not_finite"),
        (np.random.default_rng(0).uniform(-1, 1, (1, 3, 40, 96)).astype(np.float32), "image_size"),
    ],
)
def test_refuses_unusable_images(images: np.ndarray, code: str) -> None:
    with pytest.raises(InputError) as caught:
        check_lpips_images(images)
    assert caught.value.code == code


def test_a_bright_photograph_is_no_picture_from_zero_to_one(backend: LpipsBackend) -> None:
    bright = np.random.default_rng(0).integers(128, 256, (1, 96, 96, 3), dtype=np.uint8)
    (features,) = backend.features(coloured(bright))
    assert np.isfinite(features).all()


def test_refuses_pictures_of_different_size(backend: LpipsBackend, make_render: Callable[..., DrapeRender]) -> None:
    with pytest.raises(InputError, match="different size"):
        backend.features([make_render(size=128), make_render(size=96)])
    one, other = backend.features([make_render(size=128)]), backend.features([make_render(size=96)])
    with pytest.raises(InputError) as caught:
        backend.table(one, other)
    assert caught.value.code == "image_size"


@pytest.mark.parametrize("net", ["alex", "vgg"])
def test_other_trunks_equal_the_package(net: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """With made-up convolution weights; the heads are the package's own."""
    import torch

    from renderer.torchvision_import import import_torchvision

    models = import_torchvision().models
    torch.manual_seed(0)
    trunk = (models.alexnet if net == "alex" else models.vgg16)(weights=None).features
    monkeypatch.setattr("metric.lpips_backend.load_backbone", lambda _: (trunk.state_dict(), "0" * 64))
    backend = LpipsBackend(net)
    pictures = np.random.default_rng(2).integers(0, 256, (3, 80, 96, 3), dtype=np.uint8)
    images = np.stack([lpips_range(picture) for picture in pictures])
    features = backend.features(coloured(pictures))
    table = backend.table(features[:1], features[1:])
    expected = [package_forward(backend, images[:1], images[[k]])[0] for k in (1, 2)]
    assert np.abs(table[0] - expected).max() < 1e-5
    assert min(expected) > 1e-3
