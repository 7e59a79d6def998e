"""What hangs on strains near the magnets is simulated on cells that hold them."""

from __future__ import annotations

import numpy as np
import pytest

from diagnosis.effect import SCALAR, Stage
from diagnosis.effects import catalogue, get_effect
from diagnosis.measurement.features import measure
from diagnosis.measurement.picture import picture_of
from diagnosis.measurement.reference import make_reference
from diagnosis.scene import SimulationScene
from diagnosis.simulation import responses
from diagnosis.simulation.drape_cache import DrapeCache
from diagnosis.simulation.responses import clean, find_responses
from diagnosis.simulation.simulator import KeyedDrape, Simulator
from diagnosis.simulation.sizes import nodes
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
    """Of two effects one goes on from cells of 12.5 mm and one from cells of 25 mm."""
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
    monkeypatch.setattr(responses, "COARSE_TOO_FAR_M", 1.0)
    reference = make_reference(state.drape, scene)
    found = find_responses(simulator, fabric, scene, state, list(started), picture, reference)
    fine = len(state.drape.vertices)
    assert started["stretch_stiffening"] == {fine}
    assert len(started["hem_weight"]) == 1 and max(started["hem_weight"]) < fine
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
