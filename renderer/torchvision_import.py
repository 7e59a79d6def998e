"""The one place that imports torchvision.

The registry's torchvision wheel carries compiled operators that need CUDA's libraries. Beside a CPU build of torch they
cannot load, and the import stops with ``operator torchvision::nms does not exist``. The models need none of those
operators, so declaring their schemas first is enough. Where the extension loads, nothing is declared.
"""

from __future__ import annotations

import importlib.util
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

from simcore.errors import MissingResourceError

WEIGHTS_VARIABLE = "DRAPEMETER_WEIGHTS"
"""Names a folder of torchvision's weights, where they are looked for before they are downloaded."""
_SCHEMAS = (
    "nms(Tensor dets, Tensor scores, float iou_threshold) -> Tensor",
    "qnms(Tensor dets, Tensor scores, float iou_threshold) -> Tensor",
)
# A library that is collected takes its schemas with it.
_kept: list[Any] = []


@cache
def import_torchvision() -> ModuleType:
    """Import torchvision, with or without its compiled operators.

    Call it before anything that imports torchvision itself (``lpips`` does).

    Returns:
        The module, its ``models`` imported.

    Raises:
        MissingResourceError: torch or torchvision is not installed.
    """
    spec = importlib.util.find_spec("torchvision")
    if spec is None or spec.origin is None or importlib.util.find_spec("torch") is None:
        raise MissingResourceError(
            "torch and torchvision are needed: install requirements.txt", code="torchvision_missing"
        )
    # torch's own library interface carries no types
    from torch import library as untyped

    make_library: Any = untyped.Library
    if not _extension_loads(Path(spec.origin).parent):
        library = make_library("torchvision", "DEF")
        for schema in _SCHEMAS:
            library.define(schema)
        _kept.append(library)
    import torchvision
    import torchvision.models

    module: ModuleType = torchvision
    return module


def _extension_loads(folder: Path) -> bool:
    from torch import ops

    load_library: Any = ops.load_library
    for path in sorted(folder.glob("_C*.so")) + sorted(folder.glob("_C*.pyd")):
        try:
            load_library(str(path))
        except (ImportError, OSError):
            continue
        return True
    return False
