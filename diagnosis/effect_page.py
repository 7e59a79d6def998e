"""The page of the catalogue: ``python -m diagnosis.effect_page docs/effects.md`` draws every effect and writes it."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from diagnosis.base_state import picture_of
from diagnosis.drape_cache import DrapeCache
from diagnosis.effect import SCALAR, Effect, Stage
from diagnosis.effects import catalogue
from diagnosis.scene import SimulationScene
from diagnosis.simulator import Simulator
from diagnosis.synthesis import SET_SENSOR
from renderer.atomic import write_atomically
from renderer.camera import CANONICAL_CAMERA
from renderer.sensor import IDEAL_SENSOR
from simcore.mesh import GridMesh
from simcore.parameters import FabricParameters
from simcore.scenes import Setup

FABRIC = FabricParameters(800.0, 600.0, 150.0, 4e-5, 3e-5, 5e-5, 0.2)
RESOLUTION_M = 0.0125
PICTURES = "pictures/effects"
HANGING = ("hem_weight", "panel_tilt", "crease", "bending_hysteresis")
"""Effects that the hanging scene shows better."""
COLOURS = 32
Array = NDArray[np.float64]


def write_page(page: Path, *, on_effect: Callable[[str], None] | None = None) -> None:
    """Simulate every effect at a typical size, draw it, and write page and pictures.

    Raises:
        SimulationError: a drape does not come to rest.
    """
    folder = page.parent / PICTURES
    folder.mkdir(parents=True, exist_ok=True)
    artist = _Artist()
    lines = [
        "# The catalogue of effects",
        "",
        "Made by `python -m diagnosis.effect_page docs/effects.md`; do not edit. Each picture: height over the panel "
        "with the effect at a typical size (left), and what it changes (right; red: nearer, blue: farther). "
        f"Fabric: stretch {FABRIC.stretch_warp:g}/{FABRIC.stretch_weft:g}/{FABRIC.stretch_bias:g} N/m, bending "
        f"{FABRIC.bending_warp:g}/{FABRIC.bending_weft:g}/{FABRIC.bending_bias:g} N·m, {FABRIC.density:g} kg/m², "
        f"{1e3 * RESOLUTION_M:g} mm mesh. Sizes in the table: range of the prior, log-uniform.",
        "",
        "Your own effect: put a file with `EFFECT = Effect(...)` into `diagnosis/effects/`: it is found by being there",
        "",
    ]
    for name, effect in catalogue().items():
        largest = artist.draw(effect, folder / f"{name}.png")
        lines += _section(effect, largest)
        if on_effect is not None:
            on_effect(name)
    write_atomically(page, "\n".join(lines).encode())


def _section(effect: Effect, largest_m: float) -> list[str]:
    size = ", ".join(
        f"{'±' if c.signed else ''}{c.low:g} to {c.high:g}" + ("" if key == SCALAR else f" ({key})")
        for key, c in effect.components.items()
    )
    typical = ", ".join(
        f"{value:.3g}" if key == SCALAR else f"{key} {value:.3g}" for key, value in effect.typical().items()
    )
    return [
        f"## `{effect.name}` ({effect.stage.value})",
        "",
        f"{effect.summary}",
        "",
        f"![{effect.name}]({PICTURES}/{effect.name}.png)",
        "",
        f"Size: {size} [{effect.unit}]. Shown: {typical}; colours end at {1e3 * largest_m:.2g} mm. "
        f"Sets `{effect.hook}`. Source: {effect.source}",
        "",
    ]


class _Artist:
    """Solves and draws; the state without effect is solved once a scene."""

    def __init__(self) -> None:
        self.simulator = Simulator(DrapeCache.default())
        self.mesh = GridMesh(RESOLUTION_M)

    def draw(self, effect: Effect, path: Path) -> float:
        """One picture; returns the change at which the colours end [m]."""
        scene = SimulationScene(
            Setup.nominal("hanging" if effect.name in HANGING else "stretch"),
            camera=CANONICAL_CAMERA,
            sensor=SET_SENSOR if effect.stage is Stage.SENSOR else IDEAL_SENSOR,
        )
        base = self.simulator.put_up(self.mesh, FABRIC, scene, 1)
        changed = effect.apply(scene, effect.typical())
        drape = base
        if (changed.setup, changed.mechanics) != (scene.setup, scene.mechanics):
            drape = self.simulator.proceed(base, FABRIC, changed)
        before = _sensed(picture_of(base.drape, scene), scene)
        after = _sensed(picture_of(drape.drape, changed), changed)
        seen = (before > 0) & (after > 0)
        change = np.where(seen, before - after, np.nan)
        largest = max(0.002, float(np.nanquantile(np.abs(change), 0.995)))
        height = np.where(after > 0, float(np.nanmax(before)) - after, np.nan)
        _save(path, height, change, largest)
        return largest


def _sensed(picture: NDArray[np.float32], scene: SimulationScene) -> Array:
    noisy = scene.sensor.apply(picture, np.random.default_rng(0), camera=scene.camera)
    return noisy.astype(np.float64)


def _save(path: Path, height: Array, change: Array, largest: float) -> None:
    from matplotlib import colormaps
    from PIL import Image

    window = (slice(20, 236), slice(28, 228))
    left = colormaps["viridis"](np.clip(height[window] / max(0.03, float(np.nanmax(height))), 0, 1))[..., :3]
    right = colormaps["RdBu_r"](np.clip(0.5 + 0.5 * change[window] / largest, 0, 1))[..., :3]
    for pixels, values in ((left, height[window]), (right, change[window])):
        pixels[~np.isfinite(values)] = 0.0
    both = np.concatenate([left, np.ones((left.shape[0], 4, 3)), right], axis=1)
    image = Image.fromarray((255 * both).astype(np.uint8)).quantize(COLOURS)
    image.save(path, optimize=True)


if __name__ == "__main__":
    write_page(Path(sys.argv[1] if len(sys.argv) > 1 else "docs/effects.md"), on_effect=print)
