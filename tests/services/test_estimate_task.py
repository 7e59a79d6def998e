"""The model of the inference process."""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient
from PIL import Image

from services.api.app import create_app
from services.db.engine import Database
from services.model_folder import load_model, require_model
from services.settings import Settings
from simcore.errors import MissingResourceError
from trainer.shipped import META_FILE, WEIGHTS_FILE


def test_a_model_that_is_replaced_is_read_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in (META_FILE, WEIGHTS_FILE):
        (tmp_path / name).write_text("first")
    read: list[Path] = []
    monkeypatch.setattr("trainer.predict.Estimator.load", lambda folder: read.append(folder) or object())
    estimators = [load_model(tmp_path), load_model(tmp_path)]
    for name in (META_FILE, WEIGHTS_FILE):
        (tmp_path / name).write_text("another")
        estimators += [load_model(tmp_path), load_model(tmp_path)]
    assert read == [tmp_path] * 3
    assert [estimators.index(one) for one in estimators] == [0, 0, 2, 2, 4, 4]


def test_a_model_that_is_gone_is_the_servers_fault(tmp_path: Path) -> None:
    with pytest.raises(MissingResourceError, match="holds no model") as caught:
        load_model(tmp_path)
    assert caught.value.code == "model_missing"


def refuse(place: Path) -> Any:
    """As the system does to a server that may not go there."""
    raise PermissionError(13, "Permission denied", str(place))


def test_a_model_that_the_server_may_not_read_is_the_servers_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("trainer.predict.Estimator.load", refuse)
    with pytest.raises(MissingResourceError, match=r"cannot read its model \(Permission denied\)") as caught:
        load_model(tmp_path)
    assert caught.value.code == "model_missing"
    (tmp_path / META_FILE).touch()
    assert require_model(tmp_path) == tmp_path
    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.raises(MissingResourceError, match="no trained model that it can read") as caught:
        require_model(tmp_path)
    assert caught.value.code == "model_missing"


def test_a_model_in_a_folder_that_the_server_may_not_enter_is_absent(
    database: Database, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = Settings(database=str(database.url), model=tmp_path / "shut")
    stream = io.BytesIO()
    Image.fromarray(np.full((256, 256), 9000, np.uint16)).save(stream, "PNG")
    picture = ("h.png", stream.getvalue())
    with TestClient(create_app(settings), base_url="http://127.0.0.1") as client, monkeypatch.context() as entering:
        entering.setattr(Path, "is_file", refuse)
        ready = client.get("/readyz")
        answer = client.post("/v1/estimates", data={"density": "0.2"}, files={"hanging": picture})
    assert (ready.status_code, ready.json()["model"]) == (200, "absent")
    assert (answer.status_code, answer.json()["code"]) == (503, "model_missing")
    assert answer.headers["retry-after"] == "60"
