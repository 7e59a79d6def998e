"""Figures of the drape distance: search, embedding, share of pairs."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from renderer.atomic import write_atomically
from simcore.scenes import Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

Picture = NDArray[np.uint8]
_BOX = (0.13, 0.11)  # of a figure's width: what a fabric's picture and name take in an embedding

Pictures = Mapping[Scene, Picture]
"""Small shaded pictures of one fabric by scene."""


def search_figure(
    path: Path, reference: Pictures, rows: Mapping[str, Sequence[tuple[str, float, Pictures]]], *, columns: int = 6
) -> None:
    """The paper's search figure: the reference, and one row of nearest fabrics a metric.

    Args:
        path: the picture to write.
        reference: pictures of what was looked for.
        rows: name of a metric to its ranking: label, distance and pictures of each fabric, nearest first.
        columns: fabrics shown a row.
    """
    shown = min(columns, max(len(ranking) for ranking in rows.values()))
    figure = new_figure(1.6 * (shown + 1), 1.35 * len(rows))
    grid = figure.subplots(len(rows), shown + 1, squeeze=False)
    for line, (metric, ranking) in zip(grid, rows.items(), strict=True):
        _show(line[0], reference, "reference")
        line[0].set_ylabel(metric, fontsize=8, parse_math=False)
        for axes, (label, distance, pictures) in zip(line[1:], ranking, strict=False):
            _show(axes, pictures, f"{label}\n{distance:.3g}")
        for axes in line[1 + len(ranking) :]:
            axes.axis("off")
    _save(figure, path)


def embedding_figure(
    path: Path,
    points: NDArray[np.float64],
    labels: Sequence[str],
    pictures: Sequence[Picture | None],
    *,
    title: str = "",
) -> None:
    """Fabrics in the plane, each as its drape and its name.

    Args:
        path: the picture to write.
        points: shape [n, 2].
        labels: n names.
        pictures: a small picture of each, grey, uint8 [H, W]; None is drawn as a point.
        title: of the figure.
    """
    from matplotlib.offsetbox import AnnotationBbox, OffsetImage

    figure = new_figure(9.0, 9.0)
    axes = figure.subplots()
    reach = 0.62 * float(np.ptp(points, axis=0).max() or 1.0)
    middle = (points.max(axis=0) + points.min(axis=0)) / 2.0
    axes.set_xlim(middle[0] - reach, middle[0] + reach)
    axes.set_ylim(middle[1] - reach, middle[1] + reach)
    axes.set_aspect("equal")
    places = spread(points, (_BOX[0] * 2 * reach, _BOX[1] * 2 * reach))
    for point, place, label, shown in zip(points, places, labels, pictures, strict=True):
        axes.plot([point[0], place[0]], [point[1], place[1]], color="0.6", lw=0.6, zorder=1)
        axes.plot(*point, "o", ms=4, color="tab:blue", zorder=11)
        if shown is not None:
            zoom = 72.0 * 8.0 * _BOX[0] / shown.shape[1]
            image = OffsetImage(shown, zoom=zoom, cmap="gray", norm=_grey_norm())
            axes.add_artist(AnnotationBbox(image, tuple(place), pad=0.1, bboxprops={"linewidth": 0.3}, zorder=3))
        axes.annotate(
            label,
            tuple(place),
            (0, -10 if shown is None else -36),
            textcoords="offset points",
            ha="center",
            fontsize=7,
            parse_math=False,  # an id may hold any character
            zorder=10,
            bbox={"pad": 0.5, "facecolor": "white", "edgecolor": "none"},
        )
    axes.set_title(title, fontsize=9, parse_math=False)
    _save(figure, path)


def spread(points: NDArray[np.float64], box: tuple[float, float], *, steps: int = 500) -> NDArray[np.float64]:
    """Places near the points at which boxes do not overlap.

    Args:
        points: shape [n, 2].
        box: width and height of each box, in the points' unit.
        steps: most moves.

    Returns:
        float64, shape [n, 2].
    """
    places: NDArray[np.float64] = points + 1e-6 * np.arange(len(points))[:, None] * np.array(box)
    size = np.array(box)
    for _ in range(steps):
        apart = places[:, None] - places[None, :]
        overlap = size - np.abs(apart)
        touching = (overlap > 0).all(axis=2) & ~np.eye(len(places), dtype=bool)
        if not touching.any():
            break
        # Push along the axis that needs the shorter way, half of it each.
        along = np.argmin(overlap / size, axis=2)
        push = np.zeros_like(places)
        for a, b in np.argwhere(touching):
            axis = along[a, b]
            push[a, axis] += 0.25 * overlap[a, b, axis] * (1.0 if apart[a, b, axis] >= 0 else -1.0)
        places = places + push
    return places


def share_figure(path: Path, shares: Mapping[str, Mapping[int, tuple[float, float]]]) -> None:
    """Share of ordered pairs with d(a, a) < d(a, b) against the number of simulations.

    Args:
        path: the picture to write.
        shares: name of a metric to N to mean and standard deviation over choices of repeats.
    """
    figure = new_figure(6.5, 4.2)
    axes = figure.subplots()
    for name, curve in shares.items():
        counts = sorted(curve)
        axes.errorbar(
            counts,
            [100 * curve[n][0] for n in counts],
            [100 * curve[n][1] for n in counts],
            label=name,
            capsize=2,
            lw=1,
        )
    axes.axhline(95, color="0.6", lw=0.8, ls="--")
    axes.set_xticks(sorted({count for curve in shares.values() for count in curve}))
    axes.set_xlabel("simulations N of each fabric in each scene")
    axes.set_ylabel("pairs with d(a, a) < d(a, b) [%]")
    axes.legend(fontsize=7)
    axes.grid(alpha=0.3)
    _save(figure, path)


def new_figure(width: float, height: float) -> Figure:
    """An empty figure that needs no screen; inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure as NewFigure

    figure = NewFigure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _show(axes: Axes, pictures: Pictures, title: str) -> None:
    axes.imshow(side_by_side(pictures), cmap="gray", vmin=0, vmax=255)
    axes.set_title(title, fontsize=7, parse_math=False)
    axes.set_xticks([])
    axes.set_yticks([])


def side_by_side(pictures: Pictures) -> Picture:
    """Hanging beside stretch, cropped to the cloth, uint8 [H, W]."""
    return np.concatenate([_crop(pictures[scene]) for scene in sorted(pictures)], axis=1)


def _crop(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    margin = picture.shape[1] // 10
    return picture[margin : picture.shape[0] - margin // 2, margin : picture.shape[1] - margin]


def _grey_norm() -> Normalize:
    from matplotlib.colors import Normalize as NewNormalize

    return NewNormalize(0, 255)


def _save(figure: Figure, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    content = io.BytesIO()
    figure.savefig(content, dpi=110, format=path.suffix.removeprefix(".") or "png")
    write_atomically(path, content.getvalue())
