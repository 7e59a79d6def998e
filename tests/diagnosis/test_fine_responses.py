"""What hangs on strains near the magnets is simulated on cells that hold them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.effect import SCALAR, Stage
from diagnosis.effects import catalogue, get_effect
from diagnosis.measurement.features import measure
from diagnosis.measurement.picture import picture_of
from diagnosis.measurement.reference import make_reference
from diagnosis.scene import SimulationScene
from diagnosis.simulation import variations
from diagnosis.simulation.drape_cache import DrapeCache
from diagnosis.simulation.responses import _effect_key, find_responses, responses_with
from diagnosis.simulation.simulator import KeyedDrape, Simulator
from diagnosis.simulation.sizes import aside, nodes
from diagnosis.simulation.variations import Variations, clean
from diagnosis.tasks.fabric_task import BASE_JITTER
from simcore.mesh import GridMesh
from simcore.parameters import FabricParameters
from simcore.scenes import Setup


def test_what_coarse_cells_do_not_hold_is_simulated_on_fine_ones() -> None:
    assert [name for name, effect in catalogue().items() if effect.fine] == ["edge_curl", "stretch_stiffening"]


def at_rest(
    folders: pytest.TempPathFactory, fabric: FabricParameters, scene: SimulationScene
) -> tuple[Simulator, KeyedDrape]:
    """A sample put up on cells of 12.5 mm, and what simulated it."""
    simulator = Simulator(DrapeCache(folders.mktemp("drapes")))
    return simulator, simulator.put_up(GridMesh(0.0125), fabric, scene, 0, BASE_JITTER)


def test_fine_responses_go_on_from_the_state_itself(
    monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Of two effects one goes on from cells of 12.5 mm alone, and the other from cells of 25 mm, too."""
    fabric = FabricParameters(1000.0, 800.0, 300.0, 2.5e-4, 2.5e-4, 2.5e-4, 0.2)
    scene = SimulationScene(Setup.nominal("stretch"))
    simulator, state = at_rest(tmp_path_factory, fabric, scene)
    picture = picture_of(state.drape, scene)
    started: dict[str, set[int]] = {"stretch_stiffening": set(), "hem_weight": set()}
    proceed = simulator.proceed

    def seen(start: KeyedDrape, one: FabricParameters, changed: SimulationScene) -> KeyedDrape:
        for name in started:
            if changed in [get_effect(name).apply(scene, size) for size in nodes(get_effect(name))]:
                started[name].add(len(start.drape.vertices))
        return proceed(start, one, changed)

    monkeypatch.setattr(simulator, "proceed", seen)
    monkeypatch.setattr(variations, "COARSE_TOO_FAR_M", 1.0)
    reference = make_reference(state.drape, scene)
    found = find_responses(simulator, fabric, scene, state, list(started), picture, reference)
    fine = len(state.drape.vertices)
    assert started["stretch_stiffening"] == {fine}
    assert len(started["hem_weight"]) == 2 and max(started["hem_weight"]) == fine
    rows = found.effects["stretch_stiffening"][0]
    strengths = [size[SCALAR] ** -2.0 for size in nodes(get_effect("stretch_stiffening"))]
    moved = np.sqrt(np.nanmean(rows**2, axis=1))
    assert (np.argsort(moved) == np.argsort(strengths)).all()


def test_what_a_moved_camera_sees_is_rendered_from_the_state_itself_in_all_pixels(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    """Coarse cells and half the pixels change more at folds and edges than a camera does that stands 6 mm aside."""
    fabric = FabricParameters(300.0, 200.0, 100.0, 1e-6, 1e-6, 1e-6, 0.1)
    scene = SimulationScene(Setup.nominal("hanging"))
    simulator, state = at_rest(tmp_path_factory, fabric, scene)
    reference = make_reference(state.drape, scene)
    cameras = [name for name, effect in catalogue().items() if effect.stage is Stage.CAMERA]
    picture = picture_of(state.drape, scene)
    find_responses(simulator, fabric, scene, state, [], picture, reference)
    solved = simulator.cost.simulations
    found = find_responses(simulator, fabric, scene, state, cameras, picture, reference)
    assert simulator.cost.simulations == solved  # nothing more
    for name in cameras:
        for size, row in zip(nodes(get_effect(name)), found.effects[name][0], strict=True):
            seen = measure(picture_of(state.drape, get_effect(name).apply(scene, size)), reference, with_pixels=False)
            np.testing.assert_allclose(row, clean(seen.vector()), atol=1e-6)


def test_what_the_states_own_cells_do_otherwise_at_half_sizes_is_added_at_all(
    monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Half sizes are then as on these cells; large ones as on coarse cells, but for the same difference."""
    fabric = FabricParameters(1000.0, 800.0, 300.0, 2.5e-4, 2.5e-4, 2.5e-4, 0.2)
    scene = SimulationScene(Setup.nominal("stretch"))
    simulator, state = at_rest(tmp_path_factory, fabric, scene)
    picture, reference = picture_of(state.drape, scene), make_reference(state.drape, scene)
    monkeypatch.setattr(variations, "COARSE_TOO_FAR_M", 1.0)
    effect = get_effect("pin_drop")
    found = find_responses(simulator, fabric, scene, state, ["pin_drop"], picture, reference)
    coarse = Variations(simulator, fabric, scene, state, picture, reference)
    changed = [effect.apply(scene, size) for size in nodes(effect)]  # from -largest to largest
    rough = np.stack([coarse.change(fabric, one) for one in changed])
    own = [coarse.on_fine_cells.change(fabric, changed[number]) for number in (1, 2)]
    assert all(np.linalg.norm(a - b) > 1e-6 for a, b in zip(own, rough[1:3], strict=True))
    expected = [rough[0] + own[0] - rough[1], *own, rough[3] + own[1] - rough[2]]
    np.testing.assert_allclose(found.effects["pin_drop"][0], expected, atol=1e-12)
    np.testing.assert_allclose(found.pins, coarse.on_fine_cells.pins(), atol=1e-12)
    beside = responses_with(simulator, fabric, scene, state, {"pin_drop": found.effects["pin_drop"]})["pin_drop"][0]
    np.testing.assert_allclose(beside, [2 * own[0], *own, 2 * own[1]], atol=1e-12)  # half sizes alone


def test_less_probable_places_are_simulated_at_half_sizes_on_the_states_own_cells_alone(
    monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> None:
    places = ({"down": 1.0, "position": 0.5}, {"down": 1.0, "position": 0.3})
    effect = replace(get_effect("crease"), places=places, odds=(2.0, 1.0), between=())
    assert sorted(aside(effect)) == [4, 5, 6, 7] and not aside(get_effect("rest_curvature"))
    fabric = FabricParameters(1000.0, 800.0, 300.0, 2.5e-4, 2.5e-4, 2.5e-4, 0.2)
    scene = SimulationScene(Setup.nominal("stretch"))
    simulator, state = at_rest(tmp_path_factory, fabric, scene)
    picture, reference = picture_of(state.drape, scene), make_reference(state.drape, scene)
    monkeypatch.setattr(variations, "COARSE_TOO_FAR_M", 1.0)
    look = Variations(simulator, fabric, scene, state, picture, reference)
    look.effect(replace(effect, places=places[:1], odds=()))
    spent = simulator.cost.simulations
    found = look.effect(effect)["vector"]
    assert simulator.cost.simulations == spent + 2
    own = [look.on_fine_cells.change(fabric, effect.apply(scene, nodes(effect)[number])) for number in (5, 6)]
    assert min(np.linalg.norm(row) for row in own) > 1e-5
    np.testing.assert_allclose(found[4:], [2 * own[0], *own, 2 * own[1]], atol=1e-12)
    likely = look.effect(replace(effect, places=places[:1], odds=()))["vector"]
    np.testing.assert_allclose(found[:4], likely, atol=1e-12)
    assert np.linalg.norm(found[3] - 2 * found[2]) > 1e-6  # of the likely place large sizes are simulated, too


def test_where_the_cloth_hangs_free_coarse_cells_serve(tmp_path_factory: pytest.TempPathFactory) -> None:
    scene = SimulationScene(Setup.nominal("hanging"))
    fabric = FabricParameters(1000.0, 800.0, 300.0, 2.5e-4, 2.5e-4, 2.5e-4, 0.2)
    simulator, state = at_rest(tmp_path_factory, fabric, scene)
    picture, reference = picture_of(state.drape, scene), make_reference(state.drape, scene)
    look = Variations(simulator, fabric, scene, state, picture, reference)
    found = find_responses(simulator, fabric, scene, state, ["hem_weight"], picture, reference)
    half = look.change(fabric, get_effect("hem_weight").apply(scene, nodes(get_effect("hem_weight"))[0]))
    np.testing.assert_allclose(found.effects["hem_weight"][0], [half, 2 * half], atol=1e-12)
    np.testing.assert_allclose(found.pins, look.pins(), atol=1e-12)


def test_responses_are_made_anew_where_other_places_are_the_likeliest() -> None:
    """Full sizes are simulated at the likeliest places alone."""
    effect, still = get_effect("crease"), KeyedDrape(None, "state")  # type: ignore[arg-type]
    scene = SimulationScene(Setup.nominal("stretch"))
    places = tuple({"down": 1.0, "position": at} for at in (0.3, 0.5, 0.7))
    keys = {
        _effect_key(replace(effect, places=places, odds=odds, between=()), still, scene)
        for odds in ((4.0, 1.0, 1.0), (1.0, 4.0, 1.0), (8.0, 2.0, 2.0))
    }
    assert len(keys) == 2
