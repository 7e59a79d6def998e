from __future__ import annotations

import socket
from pathlib import Path
from typing import Any
from urllib.error import URLError

import pytest
import torch
from safetensors.torch import save_file

from renderer.connect_timeout import CONNECT_TIMEOUT_S
from renderer.torchvision_import import WEIGHTS_VARIABLE, import_torchvision
from simcore.errors import InputError, MissingResourceError
from trainer.pretrained import find_pretrained, load_pretrained_trunk
from trainer.trunk import ResNet18Trunk


@pytest.fixture
def weights_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    torch.manual_seed(0)
    state = import_torchvision().models.resnet18(weights=None).state_dict()
    save_file(state, tmp_path / "resnet18_random.safetensors")
    monkeypatch.setenv(WEIGHTS_VARIABLE, str(tmp_path))
    return tmp_path


def test_a_grey_picture_is_seen_as_the_colour_network_would(weights_folder: Path) -> None:
    torch.manual_seed(0)
    colour = ResNet18Trunk(3).eval()
    reference = import_torchvision().models.resnet18(weights=None)
    trunk = ResNet18Trunk(2).eval()
    origin = load_pretrained_trunk(trunk)
    assert origin.name == "resnet18_random.safetensors" and len(origin.sha256) == 64
    torch.manual_seed(0)
    reference = import_torchvision().models.resnet18(weights=None)
    colour.load_state_dict({k: v for k, v in reference.state_dict().items() if not k.startswith("fc.")})
    grey = torch.randn(1, 1, 64, 64)
    both = torch.cat([grey, torch.randn(1, 1, 64, 64)], dim=1)
    assert torch.allclose(trunk(both), colour(grey.repeat(1, 3, 1, 1)), atol=1e-4)


def test_a_narrow_trunk_cannot_take_them(weights_folder: Path) -> None:
    with pytest.raises(InputError, match=r"this one has 256: set trunk_width to 1 or train from scratch") as caught:
        load_pretrained_trunk(ResNet18Trunk(1, width=0.5))
    assert caught.value.code == "pretrained_width"


def test_without_weights_the_error_names_the_ways_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_network(*_: Any, **__: Any) -> None:
        raise URLError("no route")

    monkeypatch.setenv(WEIGHTS_VARIABLE, str(tmp_path))
    monkeypatch.setattr("torchvision.models._api.load_state_dict_from_url", no_network)
    with pytest.raises(MissingResourceError, match="train from scratch") as caught:
        load_pretrained_trunk(ResNet18Trunk(1))
    assert caught.value.code == "weights_missing" and str(tmp_path) in str(caught.value)


def test_a_download_does_not_wait_for_ever(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    patience: list[float | None] = []

    def silent(*_: Any, **__: Any) -> None:
        patience.append(socket.getdefaulttimeout())
        raise TimeoutError("timed out")

    monkeypatch.setenv(WEIGHTS_VARIABLE, str(tmp_path))
    monkeypatch.setattr("torchvision.models._api.load_state_dict_from_url", silent)
    with pytest.raises(MissingResourceError, match="timed out") as caught:
        find_pretrained()
    assert caught.value.code == "weights_missing"
    assert patience == [CONNECT_TIMEOUT_S] and socket.getdefaulttimeout() is None


def test_shared_weights_fit(shared_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(WEIGHTS_VARIABLE, str(shared_dir / "weights"))
    trunk = ResNet18Trunk(1).eval()
    load_pretrained_trunk(trunk)
    assert torch.isfinite(trunk(torch.randn(1, 1, 64, 64))).all()


@pytest.mark.parametrize("name", ["resnet18.safetensors", "resnet18.pth"])
@pytest.mark.parametrize("content", [b"", b"no weights at all", "a whole model", "another network"])
def test_a_file_that_holds_no_such_weights_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, content: bytes | str
) -> None:
    monkeypatch.setenv(WEIGHTS_VARIABLE, str(tmp_path))
    path = tmp_path / name
    state = {"conv1.weight": torch.zeros(2, 3, 7, 7)} if content == "another network" else {"model": torch.zeros(1)}
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif name.endswith("pth"):
        torch.save(state, path)
    else:
        save_file(state, path)
    with pytest.raises(InputError, match=name) as caught:
        load_pretrained_trunk(ResNet18Trunk(1))
    assert caught.value.code == "weights_unusable" and "\n" not in str(caught.value)
