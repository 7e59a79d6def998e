"""ImageNet weights for the trunk: a local folder first, else torchvision's download; never needed."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path
from pickle import UnpicklingError
from urllib.error import URLError

import torch
from torch import Tensor

from renderer.connect_timeout import connect_timeout
from renderer.torchvision_import import WEIGHTS_VARIABLE, import_torchvision
from simcore.errors import InputError, MissingResourceError
from trainer.trunk import ResNet18Trunk

PATTERNS = ("resnet18*.safetensors", "resnet18*.pth")
_UNUSED = ("fc.weight", "fc.bias")


@dataclass(frozen=True)
class BaseWeights:
    """Where a trunk's first weights came from; stored with the model, for their terms bind what is derived from them.

    Attributes:
        name: file name, or torchvision's name of the weights.
        sha256: of the file; empty for torchvision's download, whose file name carries its hash.
    """

    name: str
    sha256: str


def load_pretrained_trunk(trunk: ResNet18Trunk) -> BaseWeights:
    """Load ImageNet weights into a full-width trunk.

    The first convolution is summed over its three colours, which equals showing it a grey picture; further input
    channels start at zero.

    Raises:
        InputError: the trunk is not of full width, or the folder's file holds no such weights.
        MissingResourceError: no weights in the folder and none to download.
    """
    if trunk.channels != 512:
        raise InputError(
            f"pre-trained weights are for the full trunk (512 channels), this one has {trunk.channels}: "
            "set trunk_width to 1 or train from scratch",
            code="pretrained_width",
        )
    state, origin = _find_weights()
    adapted = {key: tensor.float() for key, tensor in state.items() if key not in _UNUSED}
    colour = adapted["conv1.weight"]
    first = torch.zeros_like(trunk.conv1.weight)
    try:
        first[:, 0] = colour.sum(dim=1)
        adapted["conv1.weight"] = first
        trunk.load_state_dict(adapted)
    except (RuntimeError, IndexError) as error:
        raise _unusable(origin.name, error) from None
    return origin


def find_pretrained() -> None:
    """Find out whether there are weights, before work that needs them later; a download is kept by torchvision.

    Raises:
        InputError: the folder's file is none.
        MissingResourceError: no weights in the folder and none to download.
    """
    _find_weights()


def _find_weights() -> tuple[dict[str, Tensor], BaseWeights]:
    folder = os.environ.get(WEIGHTS_VARIABLE)
    if folder:
        for pattern in PATTERNS:
            for path in sorted(Path(folder).glob(pattern)):
                return _read(path), BaseWeights(path.name, hashlib.sha256(path.read_bytes()).hexdigest())
    weights = import_torchvision().models.ResNet18_Weights.IMAGENET1K_V1
    try:
        with connect_timeout():
            state = weights.get_state_dict(progress=False, check_hash=True)
    except (URLError, OSError, RuntimeError) as error:
        where = f"the folder {folder} ({WEIGHTS_VARIABLE}) has none" if folder else f"{WEIGHTS_VARIABLE} is not set"
        raise MissingResourceError(
            f"no ResNet-18 weights: {where} and torchvision's download failed ({error}); put resnet18*.safetensors or "
            f"resnet18*.pth into a folder and name it in {WEIGHTS_VARIABLE}, or train from scratch",
            code="weights_missing",
        ) from None
    return state, BaseWeights(Path(weights.url).name, "")  # which ends in the first digits of its hash


def _read(path: Path) -> dict[str, Tensor]:
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    try:
        state = load_file(path) if path.suffix == ".safetensors" else torch.load(path, "cpu", weights_only=True)
    except (OSError, EOFError, RuntimeError, ValueError, UnpicklingError, SafetensorError) as error:
        raise _unusable(path, error) from None
    tensors = isinstance(state, dict) and all(isinstance(value, Tensor) for value in state.values())
    if not tensors or "conv1.weight" not in state:
        raise _unusable(path, "it holds no state of a ResNet-18")
    return dict(state)


def _unusable(file: Path | str, why: object) -> InputError:
    said = " ".join(str(why).split())[:200]
    return InputError(
        f"{file} ({WEIGHTS_VARIABLE}) cannot be used as ResNet-18 weights: {said}; put another file there",
        code="weights_unusable",
    )
