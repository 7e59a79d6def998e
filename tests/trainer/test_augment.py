from __future__ import annotations

from dataclasses import fields

import pytest
import torch

from trainer.augment import Augmenter
from trainer.config import AugmentConfig

KINDS = ("thin_plate", "perspective", "rescale", "blur", "noise", "posterise", "erase")


def _cloth() -> torch.Tensor:
    y, x = torch.meshgrid(torch.linspace(-1, 1, 64), torch.linspace(-1, 1, 64), indexing="ij")
    height = torch.where((x.abs() < 0.7) & (y.abs() < 0.7), 0.05 + 0.03 * torch.sin(6 * x + y), torch.zeros(()))
    return height[None, None].repeat(8, 1, 1, 1)


def _only(kind: str) -> AugmentConfig:
    return AugmentConfig(**{name: float(name == kind) for name in KINDS})


def test_the_order_is_the_order_of_the_fields() -> None:
    assert tuple(field.name for field in fields(AugmentConfig))[: len(KINDS)] == KINDS


@pytest.mark.parametrize("kind", KINDS)
def test_each_changes_the_cloth_a_little(kind: str) -> None:
    pictures = _cloth()
    changed = Augmenter(_only(kind))(pictures, seed=1)
    difference = (changed - pictures).abs()
    assert changed.shape == pictures.shape and torch.isfinite(changed).all()
    assert 1e-5 < float(difference.mean()) < 0.01
    assert len({float(d) for d in difference.mean(dim=(1, 2, 3))}) > 1  # every picture its own


def test_a_seed_of_any_size_is_one() -> None:
    """As everywhere else in a training, which would fail behind its last step."""
    pictures = _cloth()
    changed = Augmenter(AugmentConfig())(pictures, seed=2**64 + 1)
    assert changed.shape == pictures.shape and not torch.equal(changed, pictures)


def test_off_changes_nothing() -> None:
    pictures = _cloth()
    assert torch.equal(Augmenter(AugmentConfig.off())(pictures, seed=1), pictures)


def test_a_batch_depends_on_its_seed_alone() -> None:
    augment, pictures = Augmenter(AugmentConfig()), _cloth()
    first = augment(pictures, seed=7)
    torch.rand(3)
    before = torch.get_rng_state()
    assert torch.equal(augment(pictures, seed=7), first)
    assert torch.equal(torch.get_rng_state(), before)
    assert not torch.equal(augment(pictures, seed=8), first)


def test_posterised_heights_keep_the_panel_and_lie_on_their_steps() -> None:
    pictures = _cloth()
    changed = Augmenter(_only("posterise"))(pictures, seed=3)
    assert torch.equal(changed[pictures == 0.0], pictures[pictures == 0.0])
    assert float((changed - pictures).abs().max()) <= 0.5 * 0.512 / 2**6 + 1e-6
    assert abs(float((changed - pictures).mean())) < 3e-4, "rounded, not cut off"
    finest = changed / (0.512 / 2**8)
    assert torch.allclose(finest, finest.round(), atol=1e-3)
