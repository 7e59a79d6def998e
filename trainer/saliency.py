"""Where the network looks: XGradCAM maps, aggregated per parameter and scene.

Source: Fu et al. 2020, "Axiom-based Grad-CAM", equation 8; the paper's section "Neural Saliency Maps".
"""

from __future__ import annotations

import argparse
import io
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from renderer.atomic import write_atomically
from simcore.parameters import ESTIMATED_NAMES
from trainer.dataset import SCENES, PairStream, PictureSource, PictureTable, batches
from trainer.model import TrainedModel, load_model
from trainer.network import DrapeNetwork, Features, fuse
from trainer.preprocess import network_images
from trainer.program import make_results_folder, told_in_one_line

STRIDE = 32
"""Pixels of the input between neighbouring cells of the trunk."""

_LEAST_SUM = 1e-7


@dataclass(frozen=True)
class SaliencyMaps:
    """Mean maps in [0, 1].

    Attributes:
        maps: scene name -> float32, shape [6 parameters, size, size].
        pictures: scene name -> number of pictures behind them.
    """

    maps: dict[str, NDArray[np.float32]]
    pictures: dict[str, int]


def xgradcam(network: DrapeNetwork, images: Tensor, density: Tensor, output: int) -> Tensor:
    """XGradCAM maps of single pictures.

    The weight of a channel is the sum of gradient times activation over the sum of the activations; the map is the
    positive part of the weighted activations. They are those of the trunk's last ReLU: the weight is a mean of the
    gradients only where no activation is negative, and behind the attention some are.

    Args:
        images: float32, shape [pictures, channels, size, size], from ``network_images``.
        density: standardised log-density, shape [pictures].
        output: index of the parameter.

    Returns:
        float32, shape [pictures, h, w] (the trunk's size), not scaled.
    """
    with torch.no_grad():
        activation = network.trunk(images)
    activation = activation.detach().requires_grad_()
    pooled = network.pool(network.attention(activation))
    present = torch.ones((len(images), 1), dtype=torch.bool)
    fused = fuse(Features(pooled.maximum[:, None], pooled.mean[:, None]), present)
    answer = network.regress(fused, density).mean[:, output].sum()
    (gradient,) = torch.autograd.grad(answer, activation)
    activation = activation.detach()
    weights = (gradient * activation).sum(dim=(2, 3)) / (activation.sum(dim=(2, 3)) + _LEAST_SUM)
    return functional.relu((weights[:, :, None, None] * activation).sum(dim=1))


def enlarge(maps: Tensor, size: int) -> Tensor:
    """Maps of the trunk's cells drawn over the input's pixels, linearly between cells.

    All of the trunk's strided layers are padded by half their kernel: cell i looks at pixel :data:`STRIDE` i and
    around, not at the middle of its share of the picture. Beyond the last cell the map goes on as it is there.

    Args:
        maps: float32, shape [pictures, h, w].
        size: edge of the result [pixel].

    Returns:
        float32, shape [pictures, size, size].
    """
    height, width = maps.shape[1:]
    cell = torch.arange(size, dtype=maps.dtype) / STRIDE
    y, x = torch.meshgrid((2.0 * cell + 1.0) / height - 1.0, (2.0 * cell + 1.0) / width - 1.0, indexing="ij")
    grid = torch.stack([x, y], dim=-1).expand(len(maps), size, size, 2)
    drawn = functional.grid_sample(maps[:, None], grid, mode="bilinear", padding_mode="border", align_corners=False)
    return drawn[:, 0]


def aggregate(model: TrainedModel, source: PictureSource, table: PictureTable) -> SaliencyMaps:
    """Mean map of every parameter and scene over the pictures of a table, each scaled to a maximum of 1 first."""
    size = model.config.network.input_size
    sums = np.zeros((len(SCENES), len(ESTIMATED_NAMES), size, size))
    counts = [0] * len(SCENES)
    stream = PairStream(source, table, size=size, passes=1, shuffled=False, cache_bytes=0)
    for batch in batches(stream, 16):
        density = torch.from_numpy(model.scaling.encode_density(batch.parameters[:, 6].numpy())).float()
        for scene in range(len(SCENES)):
            rows = batch.present[:, scene]
            if not rows.any():
                continue
            images = network_images(batch.pictures[rows, scene], model.config.network)
            counts[scene] += len(images)
            for output in range(len(ESTIMATED_NAMES)):
                maps = xgradcam(model.network, images, density[rows], output)
                maps = maps / maps.amax(dim=(1, 2), keepdim=True).clamp_min(_LEAST_SUM)
                sums[scene, output] += enlarge(maps, size).sum(dim=0).numpy()
    seen = [scene for scene in range(len(SCENES)) if counts[scene]]
    return SaliencyMaps(
        {SCENES[s].value: (sums[s] / counts[s]).astype(np.float32) for s in seen},
        {SCENES[s].value: counts[s] for s in seen},
    )


def save_figure(maps: SaliencyMaps, path: Path) -> None:
    """A PNG, whole or not there: a row a scene, a column a parameter."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(2.0 * len(ESTIMATED_NAMES), 2.2 * len(maps.maps)), layout="constrained")
    axes = figure.subplots(len(maps.maps), len(ESTIMATED_NAMES), squeeze=False)
    for row, (scene, images) in zip(axes, maps.maps.items(), strict=True):
        for axis, image, name in zip(row, images, ESTIMATED_NAMES, strict=True):
            axis.imshow(image, cmap="inferno", vmin=0.0, vmax=float(max(image.max(), _LEAST_SUM)))
            axis.set_title(f"{scene}\n{name}", fontsize=8)
            axis.set_axis_off()
    content = io.BytesIO()
    FigureCanvasAgg(figure).print_figure(content, dpi=120, format="png")
    write_atomically(path, content.getvalue())


def main() -> None:
    """`python -m trainer.saliency --model model/ --store store.zarr --out maps/`."""
    from trainer.store_source import StoreSource

    parser = argparse.ArgumentParser(description="Saliency maps of a model, aggregated per parameter and scene.")
    parser.add_argument("--model", required=True)
    parser.add_argument("--store", required=True)
    parser.add_argument("--out", required=True, type=Path)
    options = parser.parse_args()
    with told_in_one_line():
        model = load_model(options.model)
        source = StoreSource(options.store, model.config.inclinations)
        pictures = source.table().upright()
        make_results_folder(options.out)
        maps = aggregate(model, source, pictures)
        content = io.BytesIO()
        np.savez_compressed(content, allow_pickle=False, **maps.maps)
        write_atomically(options.out / "saliency.npz", content.getvalue())
        save_figure(maps, options.out / "saliency.png")
        write_atomically(options.out / "saliency.json", (json.dumps({"pictures": maps.pictures}) + "\n").encode())


if __name__ == "__main__":
    main()
