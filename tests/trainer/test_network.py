"""The network against the paper's equations and torchvision's own trunk."""

from __future__ import annotations

import pytest
import torch

from renderer.torchvision_import import import_torchvision
from trainer.config import NetworkConfig
from trainer.network import DrapeNetwork, Features, Prediction, fuse
from trainer.trunk import ResNet18Trunk, SelfAttention

SMALL = NetworkConfig(input_size=64, trunk_width=0.125, hidden=(16,), dropout=0.0)


@pytest.fixture
def network() -> DrapeNetwork:
    torch.manual_seed(0)
    return DrapeNetwork(SMALL).eval()


def predict(network: DrapeNetwork, images: torch.Tensor, present: torch.Tensor, density: torch.Tensor) -> Prediction:
    """As training does, of pictures [pictures, channels, size, size] that are ``present`` [samples, scenes]."""
    return network.regress(fuse(network.extract_by_scene(images, present), present), density)


def test_trunk_is_torchvisions_resnet18_but_for_its_input() -> None:
    reference = import_torchvision().models.resnet18(weights=None).eval()
    trunk = ResNet18Trunk(3).eval()
    state = {k: v for k, v in reference.state_dict().items() if not k.startswith("fc.")}
    trunk.load_state_dict(state, strict=True)
    images = torch.randn(2, 3, 64, 64)
    x = reference.maxpool(reference.relu(reference.bn1(reference.conv1(images))))
    expected = reference.layer4(reference.layer3(reference.layer2(reference.layer1(x))))
    assert torch.equal(trunk(images), expected)


def test_attention_is_sagans() -> None:
    torch.manual_seed(1)
    layer = SelfAttention(16)
    x = torch.randn(2, 16, 3, 4)
    assert torch.equal(layer(x), x)  # gamma starts at 0
    layer.gamma.data.fill_(0.7)
    expected = torch.empty_like(x)
    flat = x.flatten(2)
    for n in range(2):
        query = layer.query.weight[:, :, 0, 0] @ flat[n]
        key = layer.key.weight[:, :, 0, 0] @ flat[n]
        value = layer.value.weight[:, :, 0, 0] @ flat[n]
        attended = torch.zeros(2, 12)
        for j in range(12):
            weights = torch.softmax(torch.stack([query[:, j] @ key[:, i] for i in range(12)]), dim=0)
            attended[:, j] = sum(w * value[:, i] for i, w in enumerate(weights))
        expected[n] = x[n] + 0.7 * (layer.out.weight[:, :, 0, 0] @ attended).reshape(16, 3, 4)
    assert torch.allclose(layer(x), expected, atol=1e-5)


def test_fusion_is_the_papers() -> None:
    maximum, mean = torch.randn(5, 2, 7), torch.randn(5, 2, 7)
    both = fuse(Features(maximum, mean), torch.ones(5, 2, dtype=torch.bool))
    assert torch.equal(both[:, :7], torch.maximum(maximum[:, 0], maximum[:, 1]))
    assert torch.allclose(both[:, 7:], (mean[:, 0] + mean[:, 1]) / 2)


def test_fusion_ignores_what_is_absent() -> None:
    maximum, mean = torch.randn(3, 2, 4), torch.randn(3, 2, 4)
    present = torch.tensor([[True, False], [False, True], [True, True]])
    fused = fuse(Features(maximum, mean), present)
    assert torch.equal(fused[0], torch.cat([maximum[0, 0], mean[0, 0]]))
    assert torch.equal(fused[1], torch.cat([maximum[1, 1], mean[1, 1]]))


def test_features_lie_where_their_pictures_are(network: DrapeNetwork) -> None:
    images = torch.randn(3, 1, 64, 64)
    present = torch.tensor([[True, True], [False, False], [False, True]])
    for alone, placed in zip(network.extract(images), network.extract_by_scene(images, present), strict=True):
        assert placed.shape == (3, 2, network.feature_channels)
        assert torch.equal(placed[present], alone)
        assert not placed[~present].any()


def test_one_scene_of_two_equals_the_single_picture(network: DrapeNetwork) -> None:
    images, density = torch.randn(2, 1, 64, 64), torch.tensor([0.3, -1.0])
    one = predict(network, images, torch.tensor([[True, False], [False, True]]), density)
    for row in (0, 1):
        here = slice(row, row + 1)
        single = predict(network, images[here], torch.ones(1, 1, dtype=torch.bool), density[here])
        assert torch.allclose(one.mean[row], single.mean[0], atol=1e-5)
        assert torch.allclose(one.log_spread[row], single.log_spread[0], atol=1e-5)


def test_order_of_scenes_does_not_matter(network: DrapeNetwork) -> None:
    images, density = torch.randn(2, 2, 1, 64, 64), torch.zeros(2)
    present = torch.ones(2, 2, dtype=torch.bool)
    found, turned = (predict(network, shown.flatten(0, 1), present, density) for shown in (images, images.flip(1)))
    assert torch.allclose(found.mean, turned.mean, atol=1e-5)


def test_spread_does_not_teach_the_features(network: DrapeNetwork) -> None:
    prediction = predict(network, torch.randn(2, 1, 64, 64), torch.ones(2, 1, dtype=torch.bool), torch.zeros(2))
    prediction.log_spread.sum().backward()
    assert network.trunk.conv1.weight.grad is None
    assert all(p.grad is not None for p in network.spread.parameters())


@pytest.mark.parametrize("field", ["use_density", "average_pooling"])
def test_switched_off_inputs_change_nothing(field: str) -> None:
    torch.manual_seed(2)
    network = DrapeNetwork(NetworkConfig(input_size=64, trunk_width=0.125, dropout=0.0, **{field: False})).eval()
    features = network.extract(torch.randn(2, 1, 64, 64))
    if field == "average_pooling":
        assert not features.mean.any()
    else:
        fused = torch.cat(list(features), dim=1)
        assert torch.equal(network.regress(fused, torch.zeros(2)).mean, network.regress(fused, torch.ones(2)).mean)
