"""Reading a store as the dataset service writes it."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from capture.normalise import normalise_depth
from renderer.camera import CANONICAL_CAMERA, frontal_pose
from renderer.depth import panel_depth
from renderer.depth_png import quantise_depth
from renderer.pose import inclination_pose
from renderer.store import RowStatus, ShardRows, StoreLayout, StoreWriter
from renderer.store_format import DEPTH_UNIT_M
from simcore.errors import InputError, StoreError
from simcore.scenes import Scene, Setup
from tests.services.s3_server import BUCKET, s3_server
from trainer.config import TrainConfig
from trainer.dataset import PairStream, batches
from trainer.preprocess import cloth_mask
from trainer.store_source import StoreSource
from trainer.symmetry import as_symmetric

TILTS = (-5.0, 0.0, 5.0)
LAYOUT = StoreLayout(
    materials=3,
    scenes=("hanging", "stretch"),
    jitters=1,
    inclinations_deg=TILTS,
    simulations_per_shard=2,
    vertex_count=4,
)


def _depth(material: int, tilt: float) -> np.ndarray:
    """A slab 10 mm (and 1 mm a material) off the panel, tilted with it."""
    depth = panel_depth(CANONICAL_CAMERA, frontal_pose() @ inclination_pose(tilt)).copy()
    depth[60:200, 60:200] -= 0.01 + 0.001 * material
    return depth


def _rows(shard: int) -> ShardRows:
    simulations = LAYOUT.shard_simulations(shard)
    rows = LAYOUT.shard_rows(shard)
    addresses = [LAYOUT.address(s) for s in simulations for _ in TILTS]
    material = np.array([a[0] for a in addresses], dtype=np.uint32)
    tilts = np.tile(TILTS, len(simulations)).astype(np.float32)
    status = np.full(len(rows), RowStatus.OK, dtype=np.uint8)
    status[material == 2] = RowStatus.NOT_STILL
    return ShardRows(
        depth=quantise_depth(
            np.stack([_depth(int(m), float(t)) for m, t in zip(material, tilts, strict=True)]), DEPTH_UNIT_M
        ),
        parameters=np.outer(1.0 + material, [500, 400, 100, 2e-5, 1e-5, 1.5e-5, 0.1]).astype(np.float32),
        scene=np.array([a[1] for a in addresses], dtype=np.uint8),
        status=status,
        reason=np.full(len(rows), "", dtype=object),
        inclination_deg=tilts,
        seed=np.arange(len(rows), dtype=np.uint64),
        material=material,
        jitter=np.zeros(len(rows), dtype=np.uint32),
        vertices=np.zeros((len(simulations), 4, 3), dtype=np.float32),
        residual=np.zeros(len(simulations)),
        energy=np.zeros(len(simulations)),
    )


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("store") / "s.zarr"
    writer = StoreWriter.create(path, LAYOUT, configuration={"resolution_m": 0.02}, seed=4, software_version="test")
    for shard in range(2):  # the third shard is never finished
        writer.write_shard(shard, _rows(shard))
    return path


def test_only_finished_rows_at_rest_are_listed(store: Path) -> None:
    table = StoreSource(store).table()
    assert len(table) == 12 and set(table.material) == {0, 1} and set(table.shard) == {0, 1}
    assert len(table.upright()) == 4
    assert table.material_parameters()[:, 0] == pytest.approx([500, 1000])


def test_heights_over_a_tilted_panel_lie_flat(store: Path) -> None:
    source = pickle.loads(pickle.dumps(StoreSource(store)))
    heights = source.read(np.arange(6))
    assert heights.dtype == torch.int16 and heights.shape == (6, 256, 256)
    assert (heights[:, 60:200, 60:200] - 100).abs().max() <= 1
    assert heights[:, :55].abs().max() <= 1


def test_as_seen_keeps_the_slope_on_the_cloth_only(store: Path) -> None:
    heights = StoreSource(store, "as_seen").read(np.arange(6))
    assert not heights[0, :55].any() and not heights[2, 210:].any()
    assert int(heights[2, 190, 100]) - int(heights[2, 70, 100]) > 200  # 5 degrees over a third of a metre
    assert (heights[1, 60:200, 60:200] == StoreSource(store).read(np.arange(6))[1, 60:200, 60:200]).all()


def test_as_seen_loses_no_cloth_that_leans_away_and_takes_no_panel_for_cloth(tmp_path: Path) -> None:
    """Also where the sensor's noise moves the panel by half a millimetre."""
    rows = _rows(0)
    rough = rows.depth + np.rint(5.0 * np.random.default_rng(2).standard_normal(rows.depth.shape)).astype(np.int64)
    for number, depth in enumerate((rows.depth, rough.astype(np.uint16))):
        path = tmp_path / f"{number}.zarr"
        writer = StoreWriter.create(path, LAYOUT, configuration={}, seed=4, software_version="test")
        writer.write_shard(0, replace(rows, depth=depth))
        cloth = cloth_mask(StoreSource(path, "as_seen").read(np.arange(6))[:, None].float() * 1e-4)[:, 0]
        assert cloth[:, 61:199, 61:199].all()
        assert int(cloth.sum()) <= 6 * 144**2  # and nothing elsewhere but its rim


def test_single_rows_equal_whole_shards(store: Path) -> None:
    source = StoreSource(store)
    assert torch.equal(source.read(np.array([8])), source.read(np.arange(6, 12))[2:3])


def test_a_fabric_listed_twice_is_one_material(tmp_path: Path) -> None:
    writer = StoreWriter.create(tmp_path / "s.zarr", LAYOUT, configuration={}, seed=4, software_version="test")
    for shard in range(2):
        rows = _rows(shard)
        writer.write_shard(shard, replace(rows, parameters=np.broadcast_to(rows.parameters[:1], (6, 7)) / (1 + shard)))
    alike = StoreSource(tmp_path / "s.zarr").table()
    assert set(alike.material) == {0} and len(alike) == 12 and len(alike.material_parameters()) == 1


def test_holes_of_a_sensor_are_closed_as_those_of_a_capture(tmp_path: Path) -> None:
    writer = StoreWriter.create(tmp_path / "s.zarr", LAYOUT, configuration={}, seed=4, software_version="test")
    rows = _rows(0)
    holed = rows.depth.copy()
    holed[:, 100:104, 100:104] = 0  # within the cloth
    holed[:, 120:160, 120:160] = 0  # too large
    writer.write_shard(0, replace(rows, depth=holed))
    heights = StoreSource(tmp_path / "s.zarr").read(np.arange(6))
    assert (heights[:, 100:104, 100:104] - 100).abs().max() <= 1
    assert not heights[:, 130:150, 130:150].any()
    depth = np.where(holed[1] > 0, holed[1] * np.float32(1e-4), np.float32(0.0))  # the upright one
    seen = normalise_depth(depth, CANONICAL_CAMERA, frontal_pose(), Setup.nominal(Scene.HANGING))
    assert np.abs(heights[1].numpy() * 1e-4 - np.where(seen.mask, seen.height, 0.0)).max() < 1.1e-4


def test_what_the_store_says_of_itself_is_kept(store: Path) -> None:
    said = StoreSource(store).provenance()
    assert said["seed"] == 4 and said["configuration"] == {"resolution_m": 0.02}


def test_no_store_and_an_empty_store(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        StoreSource(tmp_path / "nothing.zarr").table()
    assert caught.value.code == "store_missing"
    StoreWriter.create(tmp_path / "e.zarr", LAYOUT, configuration={}, seed=0, software_version="test")
    with pytest.raises(
        InputError, match=r"not one usable picture in 18 rows; see `drapemeter dataset inspect`"
    ) as caught:
        StoreSource(tmp_path / "e.zarr").table()
    assert caught.value.code == "store_empty"


@pytest.mark.slow
def test_spawned_workers_stream_from_s3(store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with s3_server(tmp_path) as server:
        for name, value in server.environment().items():
            monkeypatch.setenv(name, value)
        url = f"s3://{BUCKET}/train.zarr"
        writer = StoreWriter.create(url, LAYOUT, configuration={}, seed=4, software_version="test")
        for shard in range(2):
            writer.write_shard(shard, _rows(shard))
        there, here = StoreSource(url), StoreSource(store)
        streams = [PairStream(s, s.table(), size=64, passes=1, shuffled=False) for s in (there, here)]
        far = torch.cat([b.pictures for b in batches(streams[0], 2, workers=1)])
        near = torch.cat([b.pictures for b in batches(streams[1], 2)])
    assert torch.equal(far, near) and len(near) == 6


def test_a_damaged_picture_is_told_however_few_are_read(tmp_path: Path) -> None:
    writer = StoreWriter.create(tmp_path / "s.zarr", LAYOUT, configuration={}, seed=4, software_version="test")
    writer.write_shard(0, _rows(0))
    (damaged,) = (path for path in (tmp_path / "s.zarr" / "depth" / "c").rglob("*") if path.is_file())
    content = bytearray(damaged.read_bytes())
    content[100:-200] = bytes(len(content) - 300)
    damaged.write_bytes(content)
    for rows in ([1], [0, 1, 2, 3, 4, 5]):
        with pytest.raises(StoreError) as caught:
            StoreSource(tmp_path / "s.zarr").read(np.array(rows))
        assert caught.value.code == "store_damaged"


@pytest.mark.parametrize(
    ("lost", "shard"),
    [
        ("parameters/c/0/0", 0),
        ("scene/c/0", 0),
        ("material/c/1", 1),
        ("inclination_deg/c/0", 0),
        ("jitter/c/1", 1),
        ("status/c/1", 1),
    ],
)
def test_a_small_object_that_is_lost_is_not_learnt_from_as_zeros(lost: str, shard: int, tmp_path: Path) -> None:
    layout = LAYOUT.model_copy(update={"materials": 2, "jitters": 2, "simulations_per_shard": 4})
    rows = ShardRows.concatenate([_rows(0), _rows(1)])
    writer = StoreWriter.create(tmp_path / "s.zarr", layout, configuration={}, seed=4, software_version="test")
    for number in range(layout.shards):
        writer.write_shard(number, replace(rows, **layout.columns(layout.shard_rows(number))))
    assert len(StoreSource(tmp_path / "s.zarr").table()) == layout.samples
    (tmp_path / "s.zarr" / lost).unlink()
    name = lost.split("/")[0]
    with pytest.raises(StoreError, match=f"shard {shard}: column {name} is not that of its rows: see") as caught:
        StoreSource(tmp_path / "s.zarr").table()
    assert caught.value.code == "store_damaged"


def test_a_loaders_own_process_tells_of_damage_in_one_line(tmp_path: Path) -> None:
    writer = StoreWriter.create(tmp_path / "s.zarr", LAYOUT, configuration={}, seed=4, software_version="test")
    for shard in range(2):
        writer.write_shard(shard, _rows(shard))
    source = StoreSource(tmp_path / "s.zarr")
    table = source.table()
    for path in (tmp_path / "s.zarr" / "depth" / "c").rglob("*"):
        if path.is_file():
            path.write_bytes(path.read_bytes()[:-50])
    with pytest.raises(StoreError) as caught:
        list(batches(PairStream(source, table, size=64, passes=1, shuffled=False), 2, workers=1))
    assert caught.value.code == "store_damaged" and "Traceback" not in str(caught.value)


def test_a_store_of_tilted_pictures_alone_says_what_to_do(store: Path) -> None:
    table = StoreSource(store).table()
    with pytest.raises(InputError, match="odd number of --inclinations") as caught:
        table.take(table.inclination_deg > 1.0).upright()
    assert caught.value.code == "no_upright_pictures"


def test_an_extended_simulators_pictures_are_not_mirrored() -> None:
    """A pin that hangs lower on the right would hang lower on the left."""
    config = TrainConfig(mirror=0.5)
    extended = {"configuration": {"simulator": [{"name": "pin_drop", "magnitude": 0.01}]}}
    assert as_symmetric(config, extended).mirror == 0.0
    merged = {"configuration": {"merged": [{"simulator": []}, extended["configuration"]]}}
    assert as_symmetric(config, merged).mirror == 0.0
    for plain in ({}, {"configuration": None}, {"configuration": {"simulator": []}}):
        assert as_symmetric(config, plain) is config
