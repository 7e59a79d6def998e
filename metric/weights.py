"""Where the back ends' weights come from: a local folder first, then torchvision's download, each checked by hash."""

from __future__ import annotations

import hashlib
import os
import urllib.error
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from renderer.connect_timeout import connect_timeout
from renderer.torchvision_import import WEIGHTS_VARIABLE
from simcore.errors import MissingResourceError

if TYPE_CHECKING:
    import torch

INSTEAD = "or choose the back end depth (--backend depth; in a study --backends depth), which needs no weights"
"""What to do otherwise, in commands that compare drapes; a diagnosis goes on without."""


@dataclass(frozen=True)
class BackboneFile:
    """One accepted file of a network's weights.

    Attributes:
        name: file name.
        sha256: the file's sha256, or its first eight digits as torchvision's own file names carry it.
    """

    name: str
    sha256: str


ACCEPTED: dict[str, tuple[BackboneFile, ...]] = {
    "squeeze": (
        BackboneFile("squeezenet1_1-b8a52dc0.pth", "b8a52dc0"),
        BackboneFile(
            "squeezenet1_1_imagenet.safetensors", "090d26787f94c7beb8b2cda7d0eaff92a356aa591fde91e56f4bfb6715872b1c"
        ),
    ),
    "alex": (BackboneFile("alexnet-owt-7be5be79.pth", "7be5be79"),),
    "vgg": (BackboneFile("vgg16-397923af.pth", "397923af"),),
}
"""Weights of each LPIPS trunk; the first is torchvision's release, which is what is downloaded."""

LPIPS_HEADS_SHA256: dict[str, str] = {
    "squeeze": "4a5350f23600cb79923ce65bb07cbf57dca461329894153e05a1346bd531cf76",
    "alex": "df73285e35b22355a2df87cdb6b70b343713b667eddbda73e1977e0c860835c0",
    "vgg": "a78928a0af1e5f0fcb1f3b9e8f8c3a2a5a3de244d830ad5c1feddc79b8432868",
}
"""Linear heads (version 0.1) that ship in the lpips package."""


def load_backbone(net: str) -> tuple[dict[str, torch.Tensor], str]:
    """Convolution weights of a trunk, float32, under torchvision's names with the ``features.`` prefix dropped.

    Args:
        net: ``squeeze``, ``alex`` or ``vgg``.

    Returns:
        State of torchvision's ``features`` module, and the sha256 of the file it came from.

    Raises:
        MissingResourceError: not in the folder that ``DRAPEMETER_WEIGHTS`` names and no download; or a hash differs.
    """
    folder = os.environ.get(WEIGHTS_VARIABLE)
    if folder:
        for candidate in ACCEPTED[net]:
            path = Path(folder) / candidate.name
            if path.is_file():
                return _read(path, candidate)
    path = _download(net, folder)
    return _read(path, ACCEPTED[net][0])


def check_hash(path: Path, expected: str) -> str:
    """sha256 of a file, which must start with ``expected``.

    Raises:
        MissingResourceError: it does not.
    """
    with path.open("rb") as stream:
        found = hashlib.file_digest(stream, "sha256").hexdigest()
    if not found.startswith(expected):
        raise MissingResourceError(
            f"{path} is damaged or not the file that was pinned (sha256 {found[:12]}..., expected {expected[:12]}...): "
            f"remove it and fetch it again, {INSTEAD}",
            code="weights_hash",
        )
    return found


def _read(path: Path, accepted: BackboneFile) -> tuple[dict[str, torch.Tensor], str]:
    import torch

    sha256 = check_hash(path, accepted.sha256)
    state: Mapping[str, Any]
    if path.suffix == ".safetensors":
        from safetensors.torch import load_file

        state = load_file(path)
    else:
        state = torch.load(path, map_location="cpu", weights_only=True)
    features = {k.split(".", 1)[1]: v.float() for k, v in state.items() if k.startswith("features.")}
    return features, sha256


def _download(net: str, folder: str | None) -> Path:
    import torch

    name = ACCEPTED[net][0].name
    target = Path(torch.hub.get_dir()) / "checkpoints" / name
    if target.is_file():
        return target
    url = f"https://download.pytorch.org/models/{name}"
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with connect_timeout():
            torch.hub.download_url_to_file(url, str(target), hash_prefix=ACCEPTED[net][0].sha256, progress=False)
    except (urllib.error.URLError, OSError, RuntimeError) as error:
        places = f"not in {folder} ({WEIGHTS_VARIABLE}), " if folder else f"{WEIGHTS_VARIABLE} is not set, "
        names = " or ".join(c.name for c in ACCEPTED[net])
        raise MissingResourceError(
            f"weights of LPIPS ({net}) are missing: {places}and {url} cannot be had ({error}). "
            f"Put {names} into a folder and set {WEIGHTS_VARIABLE} to it, {INSTEAD}",
            code="weights_missing",
        ) from None
    return target
