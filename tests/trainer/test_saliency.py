from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from trainer.ablation import as_long, input_influence, ladder, table
from trainer.config import NetworkConfig
from trainer.model import TrainedModel
from trainer.network import DrapeNetwork, fuse
from trainer.presets import PRESETS
from trainer.saliency import aggregate, enlarge, save_figure, xgradcam
from trainer.trunk import ResNet18Trunk, SelfAttention

from .analytic import AnalyticSource


def test_xgradcam_by_hand() -> None:
    """A regressor that is linear in the pooled means has maps that can be written down."""
    torch.manual_seed(0)
    network = DrapeNetwork(NetworkConfig(input_size=64, trunk_width=0.125, hidden=(), dropout=0.0)).eval()
    channels = network.feature_channels
    linear = network.regressor[-1]
    assert isinstance(linear, torch.nn.Linear)
    with torch.no_grad():
        linear.weight.zero_()
        linear.weight[2, channels : 2 * channels] = torch.linspace(-1, 1, channels)
    images = torch.randn(3, 1, 64, 64)
    activation = network.feature_map(images).detach()
    places = activation.shape[2] * activation.shape[3]
    # d(mean)/d(activation) = 1 / places everywhere, so a channel's weight is its coefficient over the places.
    expected = torch.relu((torch.linspace(-1, 1, channels)[:, None, None] / places * activation).sum(dim=1))
    assert torch.allclose(xgradcam(network, images, torch.zeros(3), 2), expected, atol=1e-5)
    assert not xgradcam(network, images, torch.zeros(3), 0).any()


def test_xgradcam_of_a_maximum_looks_at_one_place_a_channel() -> None:
    torch.manual_seed(0)
    network = DrapeNetwork(NetworkConfig(input_size=64, trunk_width=0.125, hidden=(), dropout=0.0)).eval()
    linear = network.regressor[-1]
    assert isinstance(linear, torch.nn.Linear)
    with torch.no_grad():
        linear.weight.zero_()
        linear.weight[0, 4] = 2.0
    images = torch.randn(1, 1, 64, 64)
    channel = network.feature_map(images).detach()[0, 4]
    # The gradient is 2 at the largest place: weight = 2 * max / sum.
    expected = torch.relu(2.0 * channel.max() / channel.sum() * channel)
    assert torch.allclose(xgradcam(network, images, torch.zeros(1), 0)[0], expected, atol=1e-4)


def test_xgradcam_with_attention_is_of_activations_that_have_no_sign() -> None:
    """Behind the attention they have: their sum, which a channel's weight is over, may be next to nothing."""
    torch.manual_seed(3)
    network = DrapeNetwork(NetworkConfig(input_size=128, trunk_width=0.125, hidden=(), dropout=0.0)).eval()
    assert isinstance(network.attention, SelfAttention)
    torch.nn.init.constant_(network.attention.gamma, 0.5)
    kept: list[torch.Tensor] = []
    images, density = torch.randn(2, 1, 128, 128), torch.zeros(2)
    attended = network.feature_map(images)
    assert (attended < 0).any() and (attended > 0).any()  # else this shows nothing
    hook = network.trunk.register_forward_hook(lambda module, given, found: kept.append(found))
    present = torch.ones((2, 1), dtype=torch.bool)
    answer = network.regress(fuse(network.extract_by_scene(images, present), present), density).mean[:, 1].sum()
    hook.remove()
    (gradient,) = torch.autograd.grad(answer, kept)
    activation = kept[0].detach()
    assert (activation >= 0).all()
    weights = (gradient * activation).sum(dim=(2, 3)) / (activation.sum(dim=(2, 3)) + 1e-7)
    expected = torch.relu(torch.einsum("pc,pchw->phw", weights, activation))
    assert expected.any()
    assert torch.allclose(xgradcam(network, images, density, 1), expected, rtol=1e-4, atol=1e-5 * float(expected.max()))


def test_maps_are_drawn_where_their_cells_look() -> None:
    """A cell's gradient has its centre of gravity at the pixel where the cell alone is drawn."""
    torch.manual_seed(0)
    trunk = ResNet18Trunk(1, 0.125).eval()
    images = torch.randn(8, 1, 256, 256, requires_grad=True)
    place = torch.arange(256.0)
    for row, column in ((3, 4), (5, 3)):
        (gradient,) = torch.autograd.grad(trunk(images)[:, :, row, column].sum(), images)
        weight = (gradient**2).sum(dim=(0, 1))
        alone = torch.zeros(1, 8, 8)
        alone[0, row, column] = 1.0
        drawn = enlarge(alone, 256)[0]
        assert drawn[32 * row, 32 * column] == drawn.max() == 1.0
        for dimension in (0, 1):
            looked, shown = ((w.sum(dim=1 - dimension) * place).sum() / w.sum() for w in (weight, drawn))
            assert abs(float(looked - shown)) < 5.0  # half a cell is 16


def test_a_map_goes_on_beyond_its_last_cell() -> None:
    assert torch.equal(enlarge(torch.full((2, 1, 1), 0.7), 32), torch.full((2, 32, 32), 0.7))
    drawn = enlarge(torch.tensor([[[0.0, 1.0], [2.0, 3.0]]]), 64)[0]
    assert torch.allclose(drawn[0, [0, 16, 32, 63]], torch.tensor([0.0, 0.5, 1.0, 1.0]))
    assert torch.allclose(drawn[[0, 16, 32, 63], 0], torch.tensor([0.0, 1.0, 2.0, 2.0]))


def test_maps_are_aggregated_per_scene_and_parameter(
    tiny_model: TrainedModel, analytic_source: AnalyticSource, tmp_path: Path
) -> None:
    pictures = analytic_source.table().of_materials(np.arange(3))
    maps = aggregate(tiny_model, analytic_source, pictures)
    assert maps.pictures == {"hanging": 6, "stretch": 6}
    for images in maps.maps.values():
        assert images.shape == (6, 64, 64) and np.isfinite(images).all()
        assert images.min() >= 0 and images.max() <= 1 + 1e-6
    save_figure(maps, tmp_path / "maps.png")
    assert (tmp_path / "maps.png").stat().st_size > 5000


def test_the_ladder_climbs_from_the_papers_baseline_to_its_model() -> None:
    steps = ladder(PRESETS["standard"], pretrained=True)
    baseline, paper = steps["baseline"], steps["+ average pooling (paper)"]
    assert not (baseline.network.attention or baseline.network.average_pooling or baseline.augment.active)
    assert paper.network.attention and paper.network.average_pooling and paper.augment.active and paper.pretrained
    assert (paper.inclinations, paper.fusion_training, paper.network.targets) == ("as_seen", "single", "log")
    assert not paper.network.height_channel
    assert "+ pre-training" not in ladder(PRESETS["quick"], pretrained=False)
    assert len({config.seed for config in steps.values()}) == 1
    assert not input_influence(PRESETS["quick"])["depth"].network.use_density


def test_upright_pictures_alone_are_learnt_from_for_as_many_steps(analytic_source: AnalyticSource) -> None:
    pictures = analytic_source.table()
    tilted = replace(pictures, inclination_deg=np.where(pictures.jitter == 0, 0.0, 5.0))  # half are upright
    base = replace(PRESETS["quick"], epochs=3, pictures_per_epoch=0)
    upright = replace(base, inclinations="upright")
    assert as_long(base, tilted) == base
    assert as_long(upright, tilted).epochs == 6


def test_the_table_has_a_row_a_configuration(tiny_model: TrainedModel) -> None:
    text = table({"a": tiny_model.metrics, "b": tiny_model.metrics})
    assert [line.split("|")[1].strip() for line in text.splitlines()[2:]] == ["a", "b"]
