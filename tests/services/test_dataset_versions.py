"""A sweep is not gone on with by another solver, nor with other fabrics, than the one that began it; a job begins
anew then.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from services import version
from services.dataset.sweep import prepare_store, shards_left
from services.jobs.kinds.dataset import store_of
from simcore.errors import InputError
from tests.services.dataset_helpers import small_sweep


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("SOLVER_VERSION", {}),
        ("SOLVER_VERSION", {"solver": "batch", "design": "grid"}),
        ("BATCH_VERSION", {"solver": "batch"}),
        ("BATCH_VERSION", {"solver": "cuda", "design": "grid"}),
        ("PRIOR_VERSION", {}),
        ("PRIOR_VERSION", {"solver": "batch", "design": "random"}),
    ],
)
def test_a_sweep_of_another_version_is_not_resumed(
    name: str, settings: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    configuration, _ = small_sweep(**settings)
    url = str(tmp_path / "s.zarr")
    everything = prepare_store(url, configuration, resume=False)
    assert shards_left(url, configuration, resume=True) == everything
    monkeypatch.setattr(version, name, getattr(version, name) + 1)
    with pytest.raises(
        InputError, match=r"was begun with version .*\+solver\d+\S*, this is .*choose another --out"
    ) as told:
        shards_left(url, configuration, resume=True)
    assert told.value.code == "store_version"


def test_a_job_that_another_version_began_goes_into_a_store_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    configuration, _ = small_sweep()
    places = []
    for _ in range(2):
        place = store_of(f"{tmp_path}/", "job_1", configuration)
        prepare_store(place, configuration, resume=False)
        assert store_of(str(tmp_path), "job_1", configuration) == place  # the next attempt goes on with it
        places.append(Path(place).name)
        monkeypatch.setattr(version, "SOLVER_VERSION", version.SOLVER_VERSION + 1)
    assert places == ["job_1.zarr", "job_1-2.zarr"]
    other, _ = small_sweep(materials=11)
    assert Path(store_of(str(tmp_path), "job_1", other)).name == "job_1-3.zarr"


@pytest.mark.parametrize(
    ("name", "settings"), [("BATCH_VERSION", {}), ("PRIOR_VERSION", {"design": "grid"}), ("PRIOR_VERSION", None)]
)
def test_what_made_nothing_of_a_sweep_does_not_end_it(
    name: str, settings: dict[str, str] | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if settings is None:
        (tmp_path / "list.csv").write_text(LIST)
        configuration, _ = small_sweep(fabrics=tmp_path / "list.csv")
    else:
        configuration, _ = small_sweep(**settings)
    url = str(tmp_path / "s.zarr")
    everything = prepare_store(url, configuration, resume=False)
    monkeypatch.setattr(version, name, getattr(version, name) + 1)
    assert shards_left(url, configuration, resume=True) == everything


LIST = (
    "stretch_warp,stretch_weft,stretch_bias,bending_warp,bending_weft,bending_bias,density\n"
    "800,600,150,4e-5,3e-5,5e-5,0.2\n"
)
