"""Weights: local folder first, hash-pinned, one clear error when there are none."""

from __future__ import annotations

import socket
import urllib.error
from pathlib import Path

import pytest

from metric.lpips_backend import LpipsBackend
from metric.weights import load_backbone
from renderer.connect_timeout import CONNECT_TIMEOUT_S
from simcore.errors import InputError, MissingResourceError


def no_internet(*_: object, **__: object) -> None:
    raise urllib.error.URLError("Name or service not known")


@pytest.fixture
def offline(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    import torch

    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "torch"))
    monkeypatch.setattr(torch.hub, "download_url_to_file", no_internet)


def test_a_download_does_not_wait_for_ever(offline: None, monkeypatch: pytest.MonkeyPatch) -> None:
    import torch

    monkeypatch.delenv("DRAPEMETER_WEIGHTS", raising=False)
    patience: list[float | None] = []

    def silent(*_: object, **__: object) -> None:
        patience.append(socket.getdefaulttimeout())
        raise TimeoutError("timed out")

    monkeypatch.setattr(torch.hub, "download_url_to_file", silent)
    with pytest.raises(MissingResourceError, match="timed out") as caught:
        load_backbone("squeeze")
    assert caught.value.code == "weights_missing"
    assert patience == [CONNECT_TIMEOUT_S] and socket.getdefaulttimeout() is None


def test_local_folder_is_used_without_a_download(
    offline: None, weights_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DRAPEMETER_WEIGHTS", str(weights_dir))
    state, sha256 = load_backbone("squeeze")
    assert state["0.weight"].shape == (64, 3, 3, 3)
    assert sha256.startswith("090d2678")


@pytest.mark.parametrize("folder", [None, "empty"])
def test_missing_weights_name_the_way_out(
    offline: None, folder: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if folder is None:
        monkeypatch.delenv("DRAPEMETER_WEIGHTS", raising=False)
    else:
        monkeypatch.setenv("DRAPEMETER_WEIGHTS", str(tmp_path))
    with pytest.raises(MissingResourceError, match="--backend depth") as caught:
        LpipsBackend("squeeze")
    assert caught.value.code == "weights_missing"
    assert "DRAPEMETER_WEIGHTS" in str(caught.value)


def test_a_wrong_file_is_refused(offline: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "squeezenet1_1_imagenet.safetensors").write_bytes(b"not the pinned file")
    monkeypatch.setenv("DRAPEMETER_WEIGHTS", str(tmp_path))
    with pytest.raises(MissingResourceError) as caught:
        load_backbone("squeeze")
    assert caught.value.code == "weights_hash"


def test_unknown_trunk() -> None:
    with pytest.raises(InputError, match="squeeze"):
        LpipsBackend("resnet")
