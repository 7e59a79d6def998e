"""An atlas that Ray's workers build is the one that a single process builds."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest

from diagnosis.atlas import build_atlas
from diagnosis.atlas_part import AtlasPart, atlas_parts
from diagnosis.effects import parse_effect
from diagnosis.simulation.drape_cache import DrapeCache
from diagnosis.synthesis import SynthesisPlan, make_capture_set
from services.cli import main
from services.dataset import atlas as on_ray
from services.dataset.atlas import solver_on_ray
from simcore.errors import InputError

PLAN = SynthesisPlan(fabrics=1, scenes=("stretch",), repeats=1, resolution_m=0.05, seed=3, pin_radius_m=0.0)


@pytest.fixture(scope="module")
def parts(tmp_path_factory: pytest.TempPathFactory) -> list[AtlasPart]:
    captures = make_capture_set(tmp_path_factory.mktemp("set"), PLAN, [parse_effect("air_draft=0.3")])
    return atlas_parts(captures, ("air_draft", "depth_scale"), 0.05)


def arrays(content: bytes) -> dict[str, np.ndarray]:
    with np.load(io.BytesIO(content)) as data:
        return {name: data[name] for name in data.files if name != "facts"}  # which tell the seconds it took


def assert_same_atlas(one: DrapeCache, other: DrapeCache) -> None:
    """Equal file for file and array for array."""
    expected, found = one.files(), other.files()
    assert found.keys() == expected.keys()
    for name, content in expected.items():
        own, there = arrays(content), arrays(found[name])
        assert own.keys() == there.keys() and all(np.array_equal(own[key], there[key]) for key in own)


@pytest.mark.slow
@pytest.mark.ray
@pytest.mark.timeout(200)
def test_workers_of_ray_keep_what_one_process_keeps(
    parts: list[AtlasPart], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here, there = DrapeCache(tmp_path / "here"), DrapeCache(tmp_path / "there")
    alone = build_atlas(parts, here)
    first = build_atlas(parts[:1], there)
    assert parts[0].is_ready(there) and not parts[1].is_ready(there)
    told: list[float] = []
    rest = build_atlas(parts, there, told.append, solver_on_ray(None, 1))
    assert first.simulations + rest.simulations == alone.simulations > 20 and sum(told) == len(parts) == 2
    assert_same_atlas(here, there)
    monkeypatch.setattr(on_ray, "ray_cluster", None)  # with nothing to solve no cluster is asked for
    assert build_atlas(parts, there, None, solver_on_ray(None, 1)).simulations == 0


def test_a_cluster_is_only_for_building_an_atlas(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main.run(["diagnose", str(tmp_path), "--out", str(tmp_path / "out"), "--address", "auto"]) == 2
    assert "--build-atlas" in capsys.readouterr().err


def test_a_cluster_that_does_not_answer_is_one_clear_error(parts: list[AtlasPart], tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        build_atlas(parts, DrapeCache(tmp_path), None, solver_on_ray("127.0.0.1:1", None))
    assert caught.value.code == "cluster_missing"
