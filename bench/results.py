"""Where a benchmark writes its numbers: found out, and made, before it begins."""

from __future__ import annotations

import argparse
from pathlib import Path


def add_json_option(parser: argparse.ArgumentParser, name: str) -> None:
    """``--json FILE``; by default ``out/bench/NAME.json``."""
    default = f"out/bench/{name}.json"
    parser.add_argument("--json", type=results_path, default=default, help=f"file for the numbers; default {default}")


def results_path(text: str) -> Path:
    """A file's path, its folder made: hours of measuring do not end for want of it."""
    path = Path(text)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise argparse.ArgumentTypeError(f"{path.parent} cannot be made: {error.strerror}") from None
    if path.is_dir():
        raise argparse.ArgumentTypeError(f"{path} is a folder: name a file")
    return path
