"""Which code and libraries simulate and render."""

from __future__ import annotations

import hashlib
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

_ENGINES = ("taichi", "open3d", "numpy", "scipy", "mkl")


def _version(package: str) -> str:
    """Of an installed package; not all are to be had on every machine."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "absent"


@cache
def engine_fingerprint() -> str:
    """sha256 over the source and the engines' versions of everything that decides what a render looks like."""
    import renderer
    import simcore

    versions = ",".join(f"{name} {_version(name)}" for name in _ENGINES)
    digest = hashlib.sha256(versions.encode())
    for package in (simcore, renderer):
        for path in sorted(Path(package.__path__[0]).rglob("*.py")):
            digest.update(path.name.encode() + path.read_bytes())
    digest.update(Path(__file__).with_name("draping.py").read_bytes())
    return digest.hexdigest()
