"""A store of analytic cloth, captures of it, and what commands say of them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from capture.capture_set import new_document, write_captures_json
from renderer.camera import CANONICAL_CAMERA, frontal_pose
from renderer.depth_png import write_depth_png
from renderer.store import RowStatus, ShardRows, StoreLayout, StoreWriter
from services.cli import main
from tests.trainer.analytic import AnalyticSource

QUICK = ["--preset", "quick", "--epochs", "1", "--trunk-width", "0.125"]


def depth_counts(source: AnalyticSource, rows: np.ndarray) -> np.ndarray:
    """The analytic cloth as the store holds it: 0.1 mm of depth, 256 x 256."""
    heights = np.kron(source.read(rows).numpy(), np.ones((1, 4, 4), dtype=np.int16))
    return (9000 - heights).astype(np.uint16)


def make_store(path: Path) -> Path:
    """16 fabrics in both scenes, all at rest."""
    source = AnalyticSource(materials=16, jitters=1)
    table = source.table()
    layout = StoreLayout(
        materials=16,
        scenes=("hanging", "stretch"),
        jitters=1,
        inclinations_deg=(0.0,),
        simulations_per_shard=8,
        vertex_count=4,
    )
    writer = StoreWriter.create(path, layout, configuration={"made": "by hand"}, seed=1, software_version="test")
    for shard in range(layout.shards):
        rows = np.asarray(layout.shard_rows(shard))
        count = len(rows)
        writer.write_shard(
            shard,
            ShardRows(
                depth=depth_counts(source, rows),
                parameters=table.parameters[rows].astype(np.float32),
                scene=table.scene[rows].astype(np.uint8),
                status=np.full(count, RowStatus.OK, dtype=np.uint8),
                reason=np.full(count, "", dtype=object),
                inclination_deg=np.zeros(count, dtype=np.float32),
                seed=np.zeros(count, dtype=np.uint64),
                material=table.material[rows].astype(np.uint32),
                jitter=np.zeros(count, dtype=np.uint32),
                vertices=np.zeros((count, 4, 3), dtype=np.float32),
                residual=np.zeros(count),
                energy=np.zeros(count),
            ),
        )
    return path


def make_capture_set(folder: Path, densities: dict[str, float | None]) -> Path:
    """Two scenes of each fabric, seen by the canonical camera."""
    source = AnalyticSource(materials=len(densities), jitters=1)
    folder.mkdir()
    captures = []
    for row, (fabric, scene) in enumerate((f, s) for f in densities for s in ("hanging", "stretch")):
        name = f"{fabric}-{scene}-0"
        write_depth_png(folder / f"{name}.png", depth_counts(source, np.array([row]))[0] * np.float32(1e-4))
        captures.append({"id": name, "fabric": fabric, "scene": scene, "repeat": 0, "depth": f"{name}.png"})
    document = new_document(
        name="analytic",
        camera=CANONICAL_CAMERA,
        fabrics=[{"id": fabric, "density": density} for fabric, density in densities.items()],
        captures=captures,
        setup={"camera_from_panel": frontal_pose().tolist()},
    )
    write_captures_json(document, folder)
    return folder


def run_json(capsys: pytest.CaptureFixture[str], *arguments: str) -> Any:
    """What a command that goes well prints with --json."""
    capsys.readouterr()
    assert main.run([*arguments, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def failure(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str]:
    """Exit status and the one line of a command that is refused."""
    capsys.readouterr()
    code = main.run(list(arguments))
    said = capsys.readouterr().err.strip()
    assert "\n" not in said and "Traceback" not in said
    return code, said
