from __future__ import annotations

import torch

from trainer.config import NetworkConfig
from trainer.preprocess import FLOOR_M, cloth_mask, equalise, network_images, resize


def _hill(size: int = 32) -> torch.Tensor:
    y, x = torch.meshgrid(torch.linspace(-1, 1, size), torch.linspace(-1, 1, size), indexing="ij")
    height = 0.05 + 0.03 * torch.sin(3 * x + y)
    return torch.where((x.abs() < 0.7) & (y.abs() < 0.7), height, torch.zeros(()))[None, None]


def test_equalise_of_a_ramp_is_uniform() -> None:
    height = torch.linspace(0.01, 0.11, 64 * 64).reshape(1, 1, 64, 64)
    mask = torch.ones_like(height, dtype=torch.bool)
    values = equalise(height, mask).flatten()
    assert torch.allclose(values, torch.linspace(0, 1, 64 * 64), atol=2e-3)


def test_equalise_by_hand() -> None:
    height = torch.tensor([[[[0.0, 0.01, 0.01], [0.02, 0.05, 0.02]]]])
    mask = torch.tensor([[[[False, True, True], [True, True, True]]]])
    expected = torch.tensor([[[[0.0, 0.2, 0.2], [0.6, 0.9, 0.6]]]])  # middle of each level's share of five pixels
    assert torch.allclose(equalise(height, mask), expected)


def test_equalise_sees_order_not_size() -> None:
    height = _hill()
    mask = cloth_mask(height)
    once, again = equalise(height, mask), equalise(height.clone(), mask.clone())
    assert torch.equal(once, again)
    assert torch.allclose(equalise(2.5 * height, mask), once, atol=1e-6)
    assert torch.allclose(equalise(height + 0.04, mask), once, atol=2e-3)
    assert not equalise(height, mask)[~mask].any()


def test_equalise_treats_pictures_apart() -> None:
    one, other = _hill(), 3.0 * _hill().flip(2)
    together = equalise(torch.cat([one, other]), torch.cat([cloth_mask(one), cloth_mask(other)]))
    assert torch.equal(together[0], equalise(one, cloth_mask(one))[0])
    assert torch.equal(together[1], equalise(other, cloth_mask(other))[0])


def test_flat_and_empty_pictures_are_finite() -> None:
    flat = torch.full((1, 1, 32, 32), 0.03)
    assert torch.allclose(equalise(flat, cloth_mask(flat)), torch.tensor(0.5))
    nothing = network_images(torch.zeros(1, 1, 64, 64), NetworkConfig(input_size=32, height_channel=True))
    assert torch.isfinite(nothing).all()


def test_sensor_noise_on_the_panel_is_not_cloth() -> None:
    noise = 0.001 * torch.randn(1, 1, 256, 256, generator=torch.Generator().manual_seed(0))
    assert cloth_mask(resize(noise, 128)).float().mean() == 0
    assert cloth_mask(torch.full((1, 1, 8, 8), 1.01 * FLOOR_M)).all()


def test_channels_and_size() -> None:
    pictures = torch.cat([_hill(256), _hill(256)])
    assert network_images(pictures, NetworkConfig(input_size=64)).shape == (2, 1, 64, 64)
    both = network_images(pictures, NetworkConfig(input_size=128, height_channel=True))
    assert both.shape == (2, 2, 128, 128)
    assert network_images(pictures, NetworkConfig(equalise=False, height_channel=True)).shape == (2, 1, 256, 256)
