"""A model's folder and the one that ships with the package, told without loading torch."""

from __future__ import annotations

from pathlib import Path

WEIGHTS_FILE, META_FILE = "weights.safetensors", "model.json"
DEFAULT_MODEL = Path(__file__).parent / "weights" / "default"
"""The model that ships with the package."""


def is_model_folder(folder: Path) -> bool:
    """Whether both files are there."""
    return (folder / META_FILE).is_file() and (folder / WEIGHTS_FILE).is_file()
