"""What is told where torchvision or torch is not installed."""

from __future__ import annotations

import importlib.util
from importlib.machinery import ModuleSpec

import pytest

from renderer.torchvision_import import import_torchvision
from simcore.errors import MissingResourceError


@pytest.mark.parametrize("absent", ["torchvision", "torch"])
def test_what_is_not_installed_is_named_with_the_way_out(absent: str, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = importlib.util.find_spec

    def find(name: str, package: str | None = None) -> ModuleSpec | None:
        return None if name == absent else whole(name, package)

    monkeypatch.setattr(importlib.util, "find_spec", find)
    with pytest.raises(
        MissingResourceError, match=r"torch and torchvision are needed: install requirements\.txt"
    ) as caught:
        import_torchvision.__wrapped__()  # what was found before is kept
    assert caught.value.code == "torchvision_missing"
