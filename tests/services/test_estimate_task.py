"""The model of the inference process."""

from __future__ import annotations

from pathlib import Path

import pytest

from services.api import estimate_task
from simcore.errors import MissingResourceError
from trainer.shipped import META_FILE, WEIGHTS_FILE


def test_a_model_that_is_replaced_is_read_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in (META_FILE, WEIGHTS_FILE):
        (tmp_path / name).write_text("first")
    read: list[Path] = []
    monkeypatch.setattr("trainer.predict.Estimator.load", lambda folder: read.append(folder) or object())
    estimators = [estimate_task._load(tmp_path), estimate_task._load(tmp_path)]
    for name in (META_FILE, WEIGHTS_FILE):
        (tmp_path / name).write_text("another")
        estimators += [estimate_task._load(tmp_path), estimate_task._load(tmp_path)]
    assert read == [tmp_path] * 3
    assert [estimators.index(one) for one in estimators] == [0, 0, 2, 2, 4, 4]


def test_a_model_that_is_gone_is_the_servers_fault(tmp_path: Path) -> None:
    with pytest.raises(MissingResourceError, match="holds no model") as caught:
        estimate_task._load(tmp_path)
    assert caught.value.code == "model_missing"
