"""A sweep is not gone on with by another solver than the one that began it."""

from __future__ import annotations

from pathlib import Path

import pytest

from services import version
from services.dataset.sweep import prepare_store, shards_left
from simcore.errors import InputError
from tests.services.dataset_helpers import small_sweep


def test_a_sweep_of_another_solver_is_not_resumed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    configuration, _ = small_sweep()
    url = str(tmp_path / "s.zarr")
    everything = prepare_store(url, configuration, resume=False)
    assert shards_left(url, configuration, resume=True) == everything
    monkeypatch.setattr(version, "SOLVER_VERSION", version.SOLVER_VERSION + 1)
    with pytest.raises(
        InputError, match=r"was begun with version .*\+solver\d+, this is .*choose another --out"
    ) as told:
        shards_left(url, configuration, resume=True)
    assert told.value.code == "store_version"
