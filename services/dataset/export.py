"""A store as plain files: 16-bit PNG pictures and a CSV table."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from renderer.atomic import NO_ROOM
from renderer.camera import CANONICAL_CAMERA, Camera, frontal_pose
from renderer.depth_png import dequantise_depth, write_depth_png
from renderer.store import RowStatus, ShardRows, Store
from renderer.store_format import DEPTH_UNIT_M, SCENE_NAMES
from services.dataset.configuration import SweepConfiguration
from services.dataset.extension import SOME_CLOTH, build_scene
from simcore.errors import DrapemeterError, InputError
from simcore.mesh import GridMesh
from simcore.parameters import PARAMETER_NAMES

Draw = Callable[[NDArray[np.float32], int, float], NDArray[np.uint8]]
"""A shaded picture of vertices [n, 3] of a material's drape at an inclination [degrees]."""

COLUMNS = (
    "sample", "depth", "shaded", "material", "scene", "jitter", "inclination_deg", "status", "reason", "seed",
    *PARAMETER_NAMES,
)  # fmt: skip


def export_store(
    store: Store,
    folder: Path,
    *,
    shaded: bool = False,
    limit: int | None = None,
    listen: Callable[[int], None] = lambda shard: None,
) -> int:
    """Write ``samples.csv`` (every finished sample, failures too) and ``depth/*.png`` (0.1 mm counts, 0 = no data).

    Args:
        store: complete or not; unfinished samples are left out.
        folder: must not exist; it appears when it is complete.
        shaded: also draw ``shaded/*.png`` from the stored drapes, white Lambertian cloth on black.
        limit: only the first so many samples.
        listen: called after each shard.

    Returns:
        Number of samples in the table.

    Raises:
        InputError: the folder exists or cannot be written.
        DrapemeterError: the disk is full.
    """
    if folder.exists():
        raise InputError(f"{folder}: is there already; choose another folder", code="export_exists")
    draw = _shader(store) if shaded else None
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=f".{folder.name[:80]}.", suffix=".part", dir=folder.parent) as aside:
            part = Path(aside) / "export"
            (part / "depth").mkdir(parents=True)
            if shaded:
                (part / "shaded").mkdir()
            with (part / "samples.csv").open("w", newline="", encoding="utf-8") as table:
                writer = csv.DictWriter(table, COLUMNS)
                writer.writeheader()
                count = _write_samples(store, part, writer, draw, len(store) if limit is None else limit, listen)
            part.rename(folder)
    except OSError as error:
        if error.errno in NO_ROOM:
            raise DrapemeterError(
                f"cannot write {folder}: {error.strerror}; make room, or name another place", code="cannot_write"
            ) from error
        raise InputError(f"{folder}: cannot be written ({error.strerror})", code="export_not_writable") from error
    return count


def _write_samples(
    store: Store,
    folder: Path,
    table: csv.DictWriter[str],
    draw: Draw | None,
    limit: int,
    listen: Callable[[int], None],
) -> int:
    count = 0
    for shard in range(store.shards):
        first = store.rows(shard).start
        if first >= limit:
            break
        if store.complete[shard]:
            rows = store.read_shard(shard)
            for place in range(min(len(rows.status), max(0, limit - first))):
                table.writerow(_write_sample(folder, rows, place, first + place, draw, store.layout.pictures))
                count += 1
        listen(shard)
    return count


def _write_sample(
    folder: Path, rows: ShardRows, place: int, sample: int, draw: Draw | None, pictures: int
) -> dict[str, Any]:
    from PIL import Image

    usable = rows.status[place] == RowStatus.OK
    row: dict[str, Any] = {
        "sample": sample,
        "depth": "",
        "shaded": "",
        "material": rows.material[place],
        "scene": SCENE_NAMES[int(rows.scene[place])],
        "jitter": rows.jitter[place],
        "inclination_deg": float(rows.inclination_deg[place]),
        "status": RowStatus(int(rows.status[place])).label,
        "reason": rows.reason[place],
        "seed": rows.seed[place],
    }
    row |= {name: repr(float(rows.parameters[place, i])) for i, name in enumerate(PARAMETER_NAMES)}
    if usable:
        row["depth"] = f"depth/{sample:09d}.png"
        write_depth_png(folder / row["depth"], dequantise_depth(rows.depth[place], DEPTH_UNIT_M), DEPTH_UNIT_M)
    if usable and draw is not None:
        row["shaded"] = f"shaded/{sample:09d}.png"
        picture = draw(rows.vertices[place // pictures], int(rows.material[place]), row["inclination_deg"])
        Image.fromarray(picture).save(folder / row["shaded"])
    return row


def _shader(store: Store) -> Draw:
    """A function that draws a drape as the camera of its own sweep saw it, at an inclination."""
    from renderer.shade import ShadedRenderer

    sweeps = list(_sweeps(store.stated["configuration"]))
    mesh = GridMesh(sweeps[0]["resolution_m"])
    views = [_view(sweep) for sweep in sweeps]
    renderers = [ShadedRenderer(camera) for camera, _ in views]
    ends = np.cumsum([sweep["materials"] for sweep in sweeps])  # a merge numbers materials on from store to store

    def draw(vertices: NDArray[np.float32], material: int, inclination: float) -> NDArray[np.uint8]:
        place = int(np.searchsorted(ends, material, side="right"))
        return renderers[place].render(vertices, mesh.triangles, mesh.uv, views[place][1], inclination_deg=inclination)

    return draw


def _sweeps(stored: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """The configurations of the sweeps that a store's is of, in order."""
    for one in stored.get("merged", ()):
        yield from _sweeps(one)
    if "merged" not in stored:
        yield stored


def _view(sweep: dict[str, Any]) -> tuple[Camera, NDArray[np.float64]]:
    """Camera and its pose from the panel: where a sweep has effects they may be others than usual."""
    if not sweep.get("simulator"):
        return CANONICAL_CAMERA, frontal_pose()
    configuration = SweepConfiguration.model_validate(sweep)
    scene = build_scene(configuration, configuration.scenes[0], SOME_CLOTH, seed=0)
    return scene.camera, scene.camera_from_panel
