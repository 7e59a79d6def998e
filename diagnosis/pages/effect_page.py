"""The catalogue's page: ``python -m diagnosis.pages.effect_page docs/effects.md`` draws every effect and writes it.

With ``--text`` the pictures stay as they are, and nothing is simulated.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from diagnosis.effect import SCALAR, Effect, Stage
from diagnosis.effects import catalogue
from diagnosis.measurement.picture import picture_of
from diagnosis.own_effect import HOW_TO_ADD
from diagnosis.scene import SimulationScene
from diagnosis.simulation.drape_cache import DrapeCache
from diagnosis.simulation.simulator import KeyedDrape, Simulator
from diagnosis.synthesis import SET_SENSOR
from renderer.atomic import write_atomically
from renderer.camera import CANONICAL_CAMERA
from renderer.sensor import IDEAL_SENSOR
from simcore.errors import InputError, SimulationError
from simcore.mesh import GridMesh
from simcore.parameters import FabricParameters
from simcore.scenes import Setup

FABRIC = FabricParameters(800.0, 600.0, 150.0, 4e-5, 3e-5, 5e-5, 0.2)
RESOLUTION_M = 0.0125
PICTURES = "pictures/effects"
HANGING = ("hem_weight", "panel_tilt", "crease", "bending_hysteresis")
"""Effects that the hanging scene shows better."""
COLOURS = 33
"""Of each half of a picture; an odd number has one for what does not change."""
Array = NDArray[np.float64]


def write_page(page: Path, *, draw: bool = True, on_effect: Callable[[str], None] | None = None) -> None:
    """Simulate every effect at a typical size, draw it, and write page and pictures.

    Args:
        page: where to; pictures go into a folder beside it.
        draw: otherwise the pictures stay as they are, and what the page says of them is kept.
        on_effect: called with the name of every effect that is done.

    Raises:
        InputError: nothing is to be drawn, and the page there does not show an effect yet.
        SimulationError: a drape does not come to rest, without an effect or with it.
    """
    folder = page.parent / PICTURES
    folder.mkdir(parents=True, exist_ok=True)
    shown = {} if draw else _shown_mm(page)
    artist = _Artist() if draw else None
    sections: list[str] = []
    for name, effect in catalogue().items():
        if artist is not None:
            shown[name] = f"{1e3 * artist.draw(effect, folder / f'{name}.png'):.2g}"
        if name not in shown:
            raise InputError(f"{page} has no picture of {name}: write it without --text", code="effect_not_drawn")
        sections += _section(effect, shown[name])
        if on_effect is not None:
            on_effect(name)
    write_atomically(page, "\n".join([*_head(catalogue()), *sections, HOW_TO_ADD]).encode())


def _shown_mm(page: Path) -> dict[str, str]:
    """Where the colours of each picture end [mm], as a page says."""
    text = page.read_text(encoding="utf-8") if page.exists() else ""
    found = {}
    for section in text.split("\n## ")[1:]:
        named, ends = re.match(r"`(\w+)`", section), re.search(r"colours end at (\S+) mm", section)
        if named is not None and ends is not None:
            found[named[1]] = ends[1]
    return found


def _head(effects: Mapping[str, Effect]) -> list[str]:
    return [
        "# The catalogue of effects",
        "",
        "Made by `python -m diagnosis.pages.effect_page docs/effects.md` (`--text`: the pictures stay as they are); "
        "do not edit. Each picture: height over the panel with the effect at a typical size "
        "(left), and what it changes (right; red: nearer, blue: farther). "
        f"Fabric: stretch {FABRIC.stretch_warp:g}/{FABRIC.stretch_weft:g}/{FABRIC.stretch_bias:g} N/m, bending "
        f"{FABRIC.bending_warp:g}/{FABRIC.bending_weft:g}/{FABRIC.bending_bias:g} N·m, {FABRIC.density:g} kg/m², "
        f"{1e3 * RESOLUTION_M:g} mm mesh.",
        "",
        "**Size** is what is believed beforehand: log-uniform over this range of absolute values, ± where both signs "
        "occur. A vector's range is that of its length, and all directions are equally probable. Sizes outside can be "
        "simulated, but are seldom believed. **Place** is what an effect has beside its size: where or which way it "
        "acts. A diagnosis tries those that are listed, equally probable where nothing else is said; others can be "
        "simulated. Where none is given, it is the first; where a part of it is, the first with that part.",
        "",
        "A command takes an effect as in `drapemeter simulate --effect crease=1.2`: a number, or components by name "
        "with commas between them, `crease=magnitude:1.2,down:0`. Components of a vector that are not given are zero.",
        "",
        "| effect | stage | size |",
        "|---|---|---|",
        *(f"| [`{name}`](#{name}-{e.stage.value}) | {e.stage.value} | {_range(e)} |" for name, e in effects.items()),
        "",
        "Your own: [at the end](#your-own-effect).",
        "",
    ]


def _section(effect: Effect, ends_mm: str) -> list[str]:
    return [
        f"## `{effect.name}` ({effect.stage.value})",
        "",
        f"{effect.summary}",
        "",
        f"![{effect.name}]({PICTURES}/{effect.name}.png)",
        "",
        f"Size: {_range(effect)}. {_places(effect)}Shown, in `{_scene_name(effect)}`: `{_written(effect)}`; "
        f"colours end at {ends_mm} mm. Sets `{effect.hook}`. Source: {effect.source}",
        "",
    ]


def _range(effect: Effect) -> str:
    """The prior's range, in words."""
    component = next(iter(effect.components.values()))
    span = f"{component.low:g} to {component.high:g} [{effect.unit}]"
    if effect.vector:
        return f"a vector ({', '.join(effect.components)}) of length {span} in any direction"
    return f"{'±' if component.signed else ''}{span}"


def _places(effect: Effect) -> str:
    """Where or which way, in words; nothing where there is no choice."""
    if not effect.places[0]:
        return ""
    tried = [",".join(f"{key}:{value:g}" for key, value in place.items()) for place in effect.tried]
    last = f"{effect.name}={SCALAR}:{_middle(effect)},{tried[-1]}"
    shares = effect.tried_shares
    likely = [f"`{place}`" for place, share in zip(tried, shares, strict=True) if share == shares.max()]
    odds = shares.max() / shares.min()
    more = "" if odds == 1.0 else f"; {' and '.join(likely)} {odds:g} times as probable as each of the others"
    return (
        f"Place: {effect.where}. Tried: {', '.join(f'`{place}`' for place in tried)}{more}; "
        f"the last in full: `{last}`. "
    )


def _written(effect: Effect) -> str:
    """An effect of typical size at its first place, as a command takes it."""
    if effect.vector:
        return f"{effect.name}=" + ",".join(f"{key}:{value:.3g}" for key, value in effect.typical().items())
    return f"{effect.name}={_middle(effect)}"


def _middle(effect: Effect) -> str:
    return f"{effect.typical()[SCALAR]:.3g}"


def _scene_name(effect: Effect) -> str:
    return "hanging" if effect.name in HANGING else "stretch"


class _Artist:
    """Solves and draws; the state without effect is solved once a scene."""

    def __init__(self) -> None:
        self.simulator = Simulator(DrapeCache.default())
        self.mesh = GridMesh(RESOLUTION_M)

    def draw(self, effect: Effect, path: Path) -> float:
        """One picture; returns the change at which the colours end [m].

        Raises:
            SimulationError: a drape does not come to rest.
        """
        scene = SimulationScene(
            Setup.nominal(_scene_name(effect)),
            camera=CANONICAL_CAMERA,
            sensor=SET_SENSOR if effect.stage is Stage.SENSOR else IDEAL_SENSOR,
        )
        base = self._put_up(scene, "without an effect")
        changed = effect.apply(scene, effect.typical())
        drape = base
        if effect.holds:  # a drape that is continued is held where it rests already, and nothing shows
            drape = self._put_up(changed, f"with {effect.name}")
        elif (changed.setup, changed.mechanics) != (scene.setup, scene.mechanics):
            drape = _at_rest(self.simulator.proceed(base, FABRIC, changed), f"with {effect.name}")
        before = _sensed(picture_of(base.drape, scene), scene)
        after = _sensed(picture_of(drape.drape, changed), changed)
        seen = (before > 0) & (after > 0)
        change = np.where(seen, before - after, np.nan)
        largest = max(0.002, float(np.nanquantile(np.abs(change), 0.995)))
        height = np.where(after > 0, float(np.nanmax(before)) - after, np.nan)
        _save(path, height, change, largest)
        return largest

    def _put_up(self, scene: SimulationScene, how: str) -> KeyedDrape:
        return _at_rest(self.simulator.put_up(self.mesh, FABRIC, scene, 1), how)


def _at_rest(drape: KeyedDrape, how: str) -> KeyedDrape:
    if not drape.drape.ok:
        raise SimulationError(
            f"the drape {how} is {drape.drape.status}: {drape.drape.reason}; give an effect of your own smaller sizes, "
            "or draw with another FABRIC or a finer RESOLUTION_M",
            code="simulation_not_still",
        )
    return drape


def _sensed(picture: NDArray[np.float32], scene: SimulationScene) -> Array:
    noisy = scene.sensor.apply(picture, np.random.default_rng(0), camera=scene.camera)
    return noisy.astype(np.float64)


def _save(path: Path, height: Array, change: Array, largest: float) -> None:
    """Height beside change, each in colours of its own map; black where there is nothing."""
    from matplotlib import colormaps
    from PIL import Image

    window = (slice(20, 236), slice(28, 228))
    steps = np.linspace(0.0, 1.0, COLOURS)
    nothing, between = 2 * COLOURS, 2 * COLOURS + 1
    maps = [colormaps[name](steps)[:, :3] for name in ("viridis", "RdBu_r")]
    colours = np.concatenate([*maps, np.zeros((1, 3)), np.ones((1, 3))])
    left = _numbers(height[window] / max(0.03, float(np.nanmax(height))), 0, nothing)
    right = _numbers(0.5 + 0.5 * change[window] / largest, COLOURS, nothing)
    image = Image.fromarray(np.concatenate([left, np.full((len(left), 4), between, np.uint8), right], axis=1))
    image.putpalette((255 * colours).astype(np.uint8).tobytes())
    image.save(path, optimize=True)


def _numbers(shares: Array, first: int, nothing: int) -> NDArray[np.uint8]:
    """Numbers of the colours of shares of a map that begins at ``first``."""
    steps = np.rint(np.clip(shares, 0.0, 1.0) * (COLOURS - 1))
    return np.where(np.isfinite(shares), first + steps, nothing).astype(np.uint8)


def main(arguments: list[str] | None = None) -> None:
    """Of the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m diagnosis.pages.effect_page", description="Write the catalogue's page."
    )
    parser.add_argument("page", type=Path, nargs="?", default=Path("docs/effects.md"))
    parser.add_argument("--text", action="store_true", help="leave the pictures as they are and simulate nothing")
    options = parser.parse_args(arguments)
    write_page(options.page, draw=not options.text, on_effect=None if options.text else print)


if __name__ == "__main__":
    main()
