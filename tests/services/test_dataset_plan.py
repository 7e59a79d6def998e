"""What a sweep resolves to: layout, seeds, fabrics, and clear lines for what cannot be used."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from services.dataset.configuration import SweepConfiguration, differences, simulation_seed
from services.dataset.fabrics import plan_sweep
from services.dataset.shard import ShardTask, shard_requests
from simcore.errors import InputError
from simcore.parameters import PARAMETER_NAMES
from simcore.prior import FabricPrior
from simcore.scenes import Scene

FABRICS = FabricPrior.default().sample(range(4))


def test_the_readme_sweep_resolves() -> None:
    configuration, _ = plan_sweep(materials=200, jitters=2)
    layout = configuration.layout
    assert (layout.simulations, layout.samples) == (800, 8800)
    assert (layout.simulations_per_shard, layout.shards) == (32, 25)
    assert configuration.inclinations_deg == tuple(float(a) for a in range(-5, 6))
    assert layout.vertex_count == 51 * 51


def test_a_shard_is_no_larger_than_the_sweep_and_a_sweep_has_an_end() -> None:
    assert SweepConfiguration.resolve(materials=2, simulations_per_shard=3_000_000).simulations_per_shard == 4
    for values in ({"materials": 3_000_000_000}, {"materials": 1, "jitters": 10**30}):
        with pytest.raises(InputError, match="less than or equal"):
            SweepConfiguration.resolve(**values)


def test_one_inclination_is_upright() -> None:
    assert SweepConfiguration.resolve(materials=1, inclinations=1).inclinations_deg == (0.0,)


def test_seeds_are_those_of_the_spawn_key() -> None:
    sequence = np.random.SeedSequence(7, spawn_key=(3, 1, 0))
    assert simulation_seed(7, (3, 1, 0)) == int(sequence.generate_state(1, np.uint64)[0])
    seeds = {simulation_seed(s, (m, c, j)) for s in (0, 1) for m in range(20) for c in (0, 1) for j in (0, 1)}
    assert len(seeds) == 160


def test_one_scene_alone_has_the_seeds_it_has_beside_the_other() -> None:
    both, fabrics = plan_sweep(materials=2, jitters=1, resolution_m=0.05)
    alone, _ = plan_sweep(materials=2, jitters=1, resolution_m=0.05, scenes=("stretch",))

    def seeds(configuration: SweepConfiguration) -> set[int]:
        layout, found = configuration.layout, set()
        for shard in range(layout.shards):
            materials = [layout.address(number)[0] for number in layout.shard_simulations(shard)]
            asked = shard_requests(ShardTask(shard, fabrics.parameters(materials), {}), configuration)
            found |= {seed for seed, request in asked.items() if request.setup.scene is Scene.STRETCH}
        return found

    assert seeds(alone) == seeds(both) and len(seeds(both)) == 2


def test_a_material_is_the_same_in_any_sweep_of_the_seed() -> None:
    _, few = plan_sweep(materials=3, seed=9)
    _, many = plan_sweep(materials=300, seed=9)
    assert np.array_equal(few.parameters([2]), many.parameters([2]))
    assert few.parameters([2]).dtype == np.float32


def test_a_fabric_named_twice_is_looked_up_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A shard names each several times, and stepping back in a Sobol sequence begins it anew."""
    _, fabrics = plan_sweep(materials=6, jitters=1)
    asked = [4, 4, 1, 5, 1]
    each = np.concatenate([fabrics.parameters([number]) for number in asked])
    looked_up: list[list[int]] = []
    sample_array = FabricPrior.sample_array

    def noted(prior: FabricPrior, indices: list[int], **others: Any) -> Any:
        looked_up.append(indices)
        return sample_array(prior, indices, **others)

    monkeypatch.setattr(FabricPrior, "sample_array", noted)
    assert np.array_equal(fabrics.parameters(asked), each)
    assert looked_up == [[1, 4, 5]]


@pytest.mark.parametrize("design", ["sobol", "random", "grid"])
def test_designs_give_usable_fabrics(design: str) -> None:
    configuration, table = plan_sweep(materials=130, design=design, ranges={"density": (0.1, 0.3)})
    values = table.parameters(range(configuration.materials))
    assert values.shape == (configuration.materials, 7) and configuration.materials > 60
    assert ((values[:, 6] >= 0.0999) & (values[:, 6] <= 0.3001)).all()
    assert bool(configuration.fabrics_digest) == (design == "grid")


def test_a_list_is_taken_as_it_is(tmp_path: Path) -> None:
    (tmp_path / "f.json").write_text(json.dumps([f.as_dict() for f in FABRICS]))
    configuration, table = plan_sweep(fabrics=tmp_path / "f.json")
    assert configuration.materials == 4 and configuration.design == "list"
    assert table.parameters([3])[0] == pytest.approx(FABRICS[3].as_array(), rel=1e-6)
    fewer, _ = plan_sweep(fabrics=tmp_path / "f.json", materials=2)
    assert fewer.materials == 2 and fewer.fabrics_digest != configuration.fabrics_digest


@pytest.mark.parametrize("beside", [{"design": "random"}, {"design": "grid"}, {"ranges": {"density": (0.1, 0.3)}}])
def test_what_draws_fabrics_does_not_go_with_a_list(beside: dict[str, Any], tmp_path: Path) -> None:
    (tmp_path / "f.json").write_text(json.dumps([f.as_dict() for f in FABRICS]))
    with pytest.raises(InputError, match="one of the two") as caught:
        plan_sweep(fabrics=tmp_path / "f.json", **beside)
    assert caught.value.code == "options_exclude"


def test_an_impossible_plate_in_a_list_is_named(tmp_path: Path) -> None:
    row = dict(zip(PARAMETER_NAMES, [100, 100, 50, 4e-5, 1e-6, 1e-6, 0.2], strict=True))
    (tmp_path / "f.json").write_text(json.dumps([FABRICS[0].as_dict(), row]))
    with pytest.raises(InputError, match=r"f\.json, fabric 2: no plate .*; 4 bending_bias must be at least") as caught:
        plan_sweep(fabrics=tmp_path / "f.json")
    assert caught.value.code == "bending_inadmissible"


@pytest.mark.parametrize(
    ("settings", "message", "code"),
    [
        ({"materials": 2, "scenes": ("hanging", "lying")}, "unknown scene 'lying'", "scene_unknown"),
        ({"materials": 2, "scenes": ("hanging", "hanging")}, "each scene once", "scenes"),
        ({"materials": 2, "scenes": ()}, "each scene once", "scenes"),
        ({"materials": 2, "ranges": {"density": (0.3, 0.1)}}, "first number must be the smaller", "range_order"),
        ({"materials": 2, "resolution_m": 0.03}, "does not divide", "resolution_does_not_divide"),
        ({"materials": 2, "resolution_m": float("nan")}, "resolution", "resolution_out_of_range"),
        ({"materials": 2, "time_limit_s": 0}, "time_limit_s", "sweep_value"),
        ({"materials": 2, "inclinations": 0}, "inclinations", "sweep_value"),
        ({"materials": 2, "seed": -1}, "seed", "sweep_value"),
        ({"materials": 0}, "materials", "sweep_value"),
        ({"materials": 0, "design": "grid"}, "a grid of 0 fabrics: give at least 1", "grid_size"),
        ({"materials": 2, "design": "cube"}, "unknown design", "design_unknown"),
        ({"materials": None}, "say how many fabrics: --materials N", "materials_missing"),
        ({"design": "list"}, "the file of fabrics: --fabrics FILE", "list_missing"),
    ],
)
def test_what_cannot_be_used_is_told(settings: dict[str, Any], message: str, code: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        plan_sweep(**settings)
    assert caught.value.code == code


def test_a_configuration_knows_itself_after_json() -> None:
    configuration, _ = plan_sweep(materials=3)
    stored = json.loads(json.dumps(configuration.model_dump(mode="json")))
    assert differences(stored, configuration) == []
    other, _ = plan_sweep(materials=3, seed=1, resolution_m=0.02)
    assert differences(stored, other) == ["resolution_m", "seed"]
