"""Stores joined into one, and written as plain files."""

from __future__ import annotations

import csv
import errno
import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from diagnosis.extension import AppliedEffect
from renderer.camera import CANONICAL_CAMERA
from renderer.store import RowStatus, Store, StoreWriter
from services.dataset.cost import estimate_cost
from services.dataset.export import _sweeps, _view, export_store
from services.dataset.merge import merge_stores
from services.dataset.sweep import prepare_store
from services.dataset.validation import validate_store
from simcore.errors import DrapemeterError, InputError, StoreError
from tests.services.dataset_helpers import small_sweep
from tests.services.dataset_rows import made_up_store, rows_of


@pytest.fixture
def stores(tmp_path: Path) -> list[Store]:
    """Three and two fabrics."""
    made = [small_sweep(materials=3), small_sweep(materials=2, seed=9)]
    return [Store.open(made_up_store(tmp_path / f"{k}.zarr", *sweep)) for k, sweep in enumerate(made)]


def test_merged_stores_hold_every_sample_once_and_are_valid(stores: list[Store], tmp_path: Path) -> None:
    merged = merge_stores(stores, str(tmp_path / "both.zarr"))
    assert len(merged) == len(stores[0]) + len(stores[1]) == 20
    assert np.unique(merged.materials).tolist() == [0, 1, 2, 3, 4]
    assert np.array_equal(merged.column("seed"), np.concatenate([s.column("seed") for s in stores]))
    assert np.array_equal(merged.parameters, np.concatenate([s.parameters for s in stores]))
    assert np.array_equal(merged.depth(13), stores[1].depth(1))
    assert np.array_equal(merged.vertices(7), stores[1].vertices(1))
    assert merged.column("drapes/energy").tolist() == [0, 1, 2, 3, 4, 5, 0, 1, 2, 3]
    assert validate_store(merged).valid
    assert [c["seed"] for c in merged.attributes["configuration"]["merged"]] == [4, 9]
    versions = [source.attributes["software_version"] for source in stores]
    assert merged.attributes["configuration"]["merged_versions"] == versions


def test_unlike_unfinished_and_single_stores_are_not_merged(stores: list[Store], tmp_path: Path) -> None:
    out = str(tmp_path / "both.zarr")
    other = Store.open(made_up_store(tmp_path / "c.zarr", *small_sweep(materials=2, inclinations=1)))
    configuration, _ = small_sweep(materials=2)
    prepare_store(str(tmp_path / "d.zarr"), configuration, resume=False)
    for sources, message, code in [
        ([], "at least two", "merge_few"),
        (stores[:1], "at least two stores", "merge_few"),
        ([stores[0], other], r"c\.zarr and .*0\.zarr differ in inclinations_deg", "merge_unlike"),
        ([stores[0], Store.open(tmp_path / "d.zarr")], r"d\.zarr is unfinished; .*--resume", "merge_unfinished"),
    ]:
        with pytest.raises(InputError, match=message) as caught:
            merge_stores(sources, out)
        assert caught.value.code == code
    assert not Path(out).exists()


def test_a_damaged_source_is_told_and_leaves_nothing(stores: list[Store], tmp_path: Path) -> None:
    (part,) = (tmp_path / "1.zarr" / "parameters" / "c" / "0").glob("*")
    content = bytearray(part.read_bytes())
    content[-1] ^= 1
    part.write_bytes(content)
    with pytest.raises(StoreError, match=r"1\.zarr: shard 0: checksum"):
        merge_stores([stores[0], Store.open(tmp_path / "1.zarr")], str(tmp_path / "both.zarr"))
    assert not (tmp_path / "both.zarr").exists()


def test_a_place_that_fails_costs_nothing_that_was_copied(stores: list[Store], tmp_path: Path) -> None:
    def fail(shard: int) -> None:
        if shard == 1:
            raise StoreError("no space left", code="store_no_space")

    out = str(tmp_path / "both.zarr")
    with pytest.raises(StoreError, match="no space"):
        merge_stores(stores, out, fail)
    assert validate_store(merge_stores(stores, out)).valid


def test_a_merge_that_was_stopped_goes_on(stores: list[Store], tmp_path: Path) -> None:
    def stop(shard: int) -> None:
        if shard == 1:
            raise KeyboardInterrupt

    out = str(tmp_path / "both.zarr")
    with pytest.raises(KeyboardInterrupt):
        merge_stores(stores, out, stop)
    assert Store.open(out).complete.tolist()[:3] == [True, True, False]
    with pytest.raises(InputError, match="choose another --out"):
        merge_stores(stores[::-1], out)
    assert validate_store(merge_stores(stores, out)).valid
    with pytest.raises(InputError, match="choose another --out"):
        merge_stores(stores, out)


def test_nothing_is_merged_into_a_source(stores: list[Store], tmp_path: Path) -> None:
    before = sorted(tmp_path.rglob("*"))
    for inside in ("0.zarr/both", "0.zarr", "1.zarr/../0.zarr/new"):
        with pytest.raises(InputError, match=r"would lie in .*0\.zarr: choose another --out") as caught:
            merge_stores(stores, str(tmp_path / inside))
        assert caught.value.code == "merge_inside"
    assert sorted(tmp_path.rglob("*")) == before


def test_a_merge_of_merges_is_drawn(stores: list[Store], tmp_path: Path) -> None:
    once = merge_stores(stores, str(tmp_path / "once.zarr"))
    twice = merge_stores([once, stores[0]], str(tmp_path / "twice.zarr"))
    assert export_store(twice, tmp_path / "out", shaded=True, limit=1) == 1
    assert len(list((tmp_path / "out" / "shaded").iterdir())) == 1


def test_the_order_of_stores_does_not_make_many_small_objects(tmp_path: Path) -> None:
    sweeps = [small_sweep(materials=2, simulations_per_shard=1), small_sweep(materials=4, simulations_per_shard=4)]
    pilot, large = (Store.open(made_up_store(tmp_path / f"{k}.zarr", *one)) for k, one in enumerate(sweeps))
    for number, stores in enumerate(([pilot, large], [large, pilot])):
        assert merge_stores(stores, str(tmp_path / f"both{number}.zarr")).layout.simulations_per_shard == 4


def test_a_shaded_picture_is_of_the_camera_that_its_sweep_had() -> None:
    """A longer focal length beside the usual one, in a merge of merges."""
    longer = AppliedEffect(name="focal_scale", size={"magnitude": 0.03})
    plain, _ = small_sweep(materials=3)
    other = plain.model_copy(update={"simulator": (longer,)})
    stored = {"merged": [plain.model_dump(mode="json"), {"merged": [other.model_dump(mode="json")]}]}
    (usual, _), (changed, _) = (_view(sweep) for sweep in _sweeps(stored))
    assert usual == CANONICAL_CAMERA and changed.fx == pytest.approx(1.03 * usual.fx)


def test_a_merge_of_unlike_cameras_is_drawn_as_its_sources_are(tmp_path: Path) -> None:
    longer = AppliedEffect(name="focal_scale", size={"magnitude": 0.03})
    sweeps = small_sweep(materials=2), small_sweep(materials=3, simulator=[longer])
    sources = [Store.open(made_up_store(tmp_path / f"{k}.zarr", *sweep)) for k, sweep in enumerate(sweeps)]
    merged = merge_stores(sources, str(tmp_path / "both.zarr"))
    drawn = []
    for name, store in (("first", sources[0]), ("second", sources[1]), ("both", merged)):
        export_store(store, tmp_path / name, shaded=True)
        drawn.append([path.read_bytes() for path in sorted((tmp_path / name / "shaded").iterdir())])
    assert drawn[2] == drawn[0] + drawn[1]
    assert drawn[0][0] != drawn[1][0]  # of the same made-up drape


def test_export_writes_pictures_and_a_table_that_agree(stores: list[Store], tmp_path: Path) -> None:
    store = stores[0]
    assert export_store(store, tmp_path / "out", shaded=True) == 12
    with (tmp_path / "out" / "samples.csv").open(newline="") as table:
        rows = list(csv.DictReader(table))
    assert [int(row["sample"]) for row in rows] == list(range(12))
    assert [row["status"] for row in rows] == ["ok"] * 10 + ["timed_out"] * 2
    assert rows[11]["reason"] == "time limit" and rows[11]["depth"] == ""
    assert float(rows[5]["density"]) == pytest.approx(float(store.parameters[5, 6]))
    picture = np.asarray(Image.open(tmp_path / "out" / rows[7]["depth"]))
    assert np.array_equal(picture, store.array("depth")[7])
    shaded = np.asarray(Image.open(tmp_path / "out" / rows[7]["shaded"]))
    assert shaded.dtype == np.uint8 and shaded.shape == (256, 256) and shaded.max() > 100


def test_export_leaves_out_what_is_unfinished_and_stops_at_its_limit(tmp_path: Path) -> None:
    configuration, fabrics = small_sweep(materials=3)
    prepare_store(str(tmp_path / "s.zarr"), configuration, resume=False)
    StoreWriter.open(tmp_path / "s.zarr").write_shard(1, rows_of(1, configuration, fabrics))
    assert export_store(Store.open(tmp_path / "s.zarr"), tmp_path / "all") == 6
    assert export_store(Store.open(tmp_path / "s.zarr"), tmp_path / "few", limit=8) == 2
    assert (Store.open(tmp_path / "s.zarr").status[:6] == RowStatus.MISSING).all()


def test_an_export_touches_nothing_but_its_own_folder(stores: list[Store], tmp_path: Path) -> None:
    (tmp_path / "out.part").mkdir()
    (tmp_path / "out.part" / "mine.txt").write_text("kept")
    export_store(stores[0], tmp_path / "out", limit=1)
    assert (tmp_path / "out.part" / "mine.txt").read_text() == "kept"
    assert {path.name for path in tmp_path.iterdir() if path.suffix != ".zarr"} == {"out", "out.part"}


def test_a_folder_that_is_there_is_not_written_into(stores: list[Store], tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    with pytest.raises(InputError, match="is there already; choose another folder") as caught:
        export_store(stores[0], tmp_path / "out")
    assert caught.value.code == "export_exists"
    assert not list((tmp_path / "out").iterdir())


def test_an_export_that_cannot_be_written_leaves_nothing(
    stores: list[Store], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("mine")
    before = sorted(tmp_path.iterdir())
    with pytest.raises(InputError, match=r"file/out: cannot be written \(") as caught:
        export_store(stores[0], tmp_path / "file" / "out")
    assert caught.value.code == "export_not_writable"

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("services.dataset.export._write_samples", full)
    with pytest.raises(DrapemeterError, match=r"out: No space left on device; make room") as caught_full:
        export_store(stores[0], tmp_path / "out")
    assert caught_full.value.code == "cannot_write" and not isinstance(caught_full.value, InputError)
    assert sorted(tmp_path.iterdir()) == before and (tmp_path / "file").read_text() == "mine"


def test_cost_grows_with_the_sweep_and_shrinks_with_workers() -> None:
    coarse, fine, finest = (small_sweep(resolution_m=h)[0] for h in (0.02, 0.005, 0.0025))
    assert estimate_cost(fine, 1).core_hours > 8 * estimate_cost(coarse, 1).core_hours  # measured: 11.6
    grown = estimate_cost(finest, 1).core_hours / estimate_cost(fine, 1).core_hours
    assert grown == pytest.approx(201**2 / 101**2, rel=0.01), "beyond the finest measured mesh as its vertices"
    assert estimate_cost(fine, 4).hours == pytest.approx(estimate_cost(fine, 1).hours / 4)
    assert estimate_cost(fine, 1, simulations=5).simulations == 5
    assert estimate_cost(coarse, 1).pictures == 40
