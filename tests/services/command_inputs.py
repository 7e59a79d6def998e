"""What commands read, in a folder: nothing that could be worked with, all that is looked at before the work."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from diagnosis.blind.make import BLIND_FORMAT, MANIFEST_FILE, MANIFEST_KEYS
from tests.capture.flat import add
from tests.services.test_cli_simulate import FABRIC


def make_inputs(folder: Path) -> None:
    """A fabric, a library, frames with their camera, a planned blind check and a capture set."""
    for name in ("check", "frames"):
        (folder / name).mkdir()
    (folder / "p.json").write_text(json.dumps(FABRIC))
    (folder / "library.json").write_text(json.dumps([{"id": "a", **FABRIC}]))
    camera = {"width": 8, "height": 8, "fx": 8.0, "fy": 8.0, "cx": 3.5, "cy": 3.5, "depth_unit_m": 1e-4}
    (folder / "camera.json").write_text(json.dumps(camera))
    (folder / "frames" / "0.png").touch()
    manifest: dict[str, Any] = {"format": BLIND_FORMAT, **dict.fromkeys(MANIFEST_KEYS), "cases": 1, "withhold": []}
    (folder / "check" / MANIFEST_FILE).write_text(json.dumps(manifest))
    add(folder / "set", density=0.2)
