"""Pictures of the catalogue's page: their colours, and the drapes that they show."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from PIL import Image

from diagnosis.effects import get_effect
from diagnosis.pages import effect_page
from diagnosis.pages.effect_page import _Artist, _save
from diagnosis.scene import SimulationScene
from diagnosis.simulation.simulator import KeyedDrape
from simcore.drape import DrapeStatus
from simcore.errors import SimulationError
from simcore.mesh import GridMesh

NOTHING = (0, 0, 0)


def colours_of(name: str) -> set[tuple[int, ...]]:
    """All colours of a map, and that of nothing."""
    table = (255 * matplotlib.colormaps[name](np.arange(256))[:, :3]).astype(int)
    return {NOTHING, *map(tuple, table.tolist())}


def test_each_half_of_a_picture_is_in_the_colours_of_its_own_map(tmp_path: Path) -> None:
    """Most of the left half is of one height and few pixels change much, as in most pictures."""
    rng = np.random.default_rng(0)
    height = 0.01 + 0.04 * rng.random((256, 256)) ** 4
    change = 0.004 * rng.standard_normal((256, 256)) ** 3
    change[100:110, 100:110] = np.nan
    change[30, 30:40], change[31, 30:40], change[32, 30:40] = 0.005, -0.005, 0.0
    _save(tmp_path / "x.png", height, change, 0.005)
    with Image.open(tmp_path / "x.png") as image:
        pixels = np.asarray(image.convert("RGB")).astype(int)
    left, right = pixels[:, :200], pixels[:, 204:]
    assert {tuple(p) for p in left.reshape(-1, 3).tolist()} <= colours_of("viridis") - {NOTHING}
    assert {tuple(p) for p in right.reshape(-1, 3).tolist()} <= colours_of("RdBu_r")
    ends = (255 * matplotlib.colormaps["RdBu_r"]([1.0, 0.0, 0.5])[:, :3]).astype(int)
    assert right[10:13, 5].tolist() == ends.tolist() and tuple(right[85, 75]) == NOTHING
    assert (pixels[:, 200:204] == 255).all()


@pytest.fixture
def artist(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> _Artist:
    """On 50 mm cells, where a drape takes a tenth of a second."""
    monkeypatch.setenv("DRAPEMETER_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(effect_page, "RESOLUTION_M", 0.05)
    return _Artist()


def test_what_holds_the_cloth_where_it_was_put_shows(artist: _Artist, tmp_path: Path) -> None:
    """Of a drape that is continued friction would change next to nothing: colours end at 2 mm at the least."""
    artist.mesh = GridMesh(0.0125)
    assert artist.draw(get_effect("panel_friction"), tmp_path / "x.png") > 0.005


@pytest.mark.parametrize(
    ("name", "fails"), [("hem_weight", "without"), ("hem_weight", "with"), ("panel_friction", "with")]
)
def test_a_drape_that_is_not_at_rest_is_not_drawn(
    name: str, fails: str, artist: _Artist, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    effect, put_up, proceed = get_effect(name), artist.simulator.put_up, artist.simulator.proceed

    def judged(keyed: KeyedDrape, scene: SimulationScene) -> KeyedDrape:
        plain = not scene.mechanics.hem_kg_m and not scene.mechanics.friction
        if plain != (fails == "without"):
            return keyed
        return replace(keyed, drape=replace(keyed.drape, status=DrapeStatus.NOT_STILL, reason="it swings"))

    monkeypatch.setattr(artist.simulator, "put_up", lambda m, f, scene, seed: judged(put_up(m, f, scene, seed), scene))
    monkeypatch.setattr(artist.simulator, "proceed", lambda start, f, scene: judged(proceed(start, f, scene), scene))
    said = f"the drape {'without an effect' if fails == 'without' else f'with {name}'} is not_still: it swings"
    with pytest.raises(SimulationError, match=said) as caught:
        artist.draw(effect, tmp_path / "x.png")
    assert caught.value.code == "simulation_not_still" and not (tmp_path / "x.png").exists()
