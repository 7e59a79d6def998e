"""`validate` notices every kind of damage, `inspect` counts what is there."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from renderer.store import Store, StoreWriter
from services.dataset.figures import relief, spearman, write_figures
from services.dataset.inspection import inspect_store
from services.dataset.sweep import count_failures, prepare_store
from services.dataset.validation import validate_store
from simcore.errors import InputError, StoreError
from tests.services.dataset_helpers import small_sweep
from tests.services.dataset_rows import made_up_store, rows_of

CONFIGURATION, FABRICS = small_sweep()


@pytest.fixture
def store(tmp_path: Path) -> Path:
    """A whole store with one failed simulation."""
    return made_up_store(tmp_path / "s.zarr", CONFIGURATION, FABRICS)


def faults(store: Path) -> str:
    """All faults found."""
    report = validate_store(Store.open(store))
    assert report.valid == (not report.faults)
    return "; ".join(report.faults)


def test_a_sound_store_is_valid_and_counted(store: Path) -> None:
    assert faults(store) == ""
    report = inspect_store(Store.open(store))
    assert (report.samples, report.ok, report.failed) == (40, 38, {"timed_out": 2})
    assert report.reasons == {"time limit": 2} and report.shards_complete == report.shards == 7
    assert report.ranges["density"][0] == pytest.approx(Store.open(store).parameters[:, 6].min())
    assert report.stored_bytes > 38 * 1000 and report.bytes_per_picture > 0
    assert count_failures(Store.open(store)) == {"timed_out": 2}


def test_rows_of_a_shard_that_is_being_written_are_missing(store: Path, tmp_path: Path) -> None:
    unfinished, begun = store / "checksum" / "c", tmp_path / "begun.zarr"
    for shard in (0, 6):
        (unfinished / str(shard) / "0").unlink()
    prepare_store(str(begun), CONFIGURATION, resume=False)
    for shard in range(1, 6):
        StoreWriter.open(begun).write_shard(shard, rows_of(shard, CONFIGURATION, FABRICS))
    assert inspect_store(Store.open(store)) == inspect_store(Store.open(begun))
    assert inspect_store(Store.open(store)).failed == {}
    assert count_failures(Store.open(store)) == count_failures(Store.open(begun)) == {"missing": 10}
    for place in (store, begun):
        write_figures(Store.open(place), place / "figures")
    drawn = [(place / "figures" / "spearman.png").read_bytes() for place in (store, begun)]
    assert drawn[0] == drawn[1]


def test_a_flipped_bit_is_noticed(store: Path) -> None:
    path = store / "depth" / "c" / "2" / "0" / "0"
    data = bytearray(path.read_bytes())
    data[1000] ^= 1
    path.write_bytes(bytes(data))
    assert "shard 2: checksum does not match" in faults(store)


def test_a_lost_object_is_noticed(store: Path) -> None:
    (store / "seed" / "c" / "1").unlink()
    assert "shard 1: seed/c/1 is missing" in faults(store)


def test_an_unfinished_shard_is_noticed(store: Path) -> None:
    (store / "checksum" / "c" / "3" / "0").unlink()
    assert "shard 3 is unfinished" in faults(store) and "--resume" in faults(store)


def test_rows_that_belong_elsewhere_are_noticed(store: Path) -> None:
    StoreWriter.open(store).write_shard(1, rows_of(0, CONFIGURATION, FABRICS))
    assert "shard 1: column material is not that of its rows" in faults(store)
    assert "shard 1: column seed is not that of its rows" in faults(store)


def test_failures_without_a_reason_and_empty_pictures_are_noticed(store: Path) -> None:
    rows = rows_of(6, CONFIGURATION, FABRICS)
    rows.reason[:] = ""
    rows.depth[:] = 0
    StoreWriter.open(store).write_shard(6, rows)
    assert "a failed row has no reason" in faults(store)
    assert "empty picture" in faults(store)


def test_a_missing_array_is_noticed(store: Path) -> None:
    (store / "jitter" / "zarr.json").unlink()
    said = f"{store}: array jitter is missing: put it back from a copy, or make the store again"
    assert faults(store) == said
    with pytest.raises(StoreError) as caught:
        _ = Store.open(store).jitter
    assert (str(caught.value), caught.value.code) == (said, "store_damaged")


def test_figures_show_fabrics_and_pictures(store: Path, tmp_path: Path) -> None:
    paths = write_figures(Store.open(store), tmp_path / "figures")
    assert [path.name for path in paths] == ["contact-sheet.png", "spearman.png"]
    assert all(path.stat().st_size > 5000 for path in paths)
    assert spearman(FABRICS.parameters(range(10)))[0, 0] == pytest.approx(1.0)


def test_relief_is_light_where_the_cloth_is_near() -> None:
    depth = np.array([[0.9, 0.85, 0.8, 0.0]], dtype=np.float32)
    assert relief(depth).tolist() == [[0, 127, 255, 0]]


def test_figures_need_a_folder(store: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    for folder in (tmp_path / "file", tmp_path / "file" / "figures"):
        with pytest.raises(InputError, match=r"cannot be made \(") as caught:
            write_figures(Store.open(store), folder)
        assert caught.value.code == "folder_not_writable"
    assert (tmp_path / "file").read_text() == "mine"


def test_an_unfinished_store_has_nothing_to_show(tmp_path: Path) -> None:
    prepare_store(str(tmp_path / "s.zarr"), CONFIGURATION, resume=False)
    with pytest.raises(InputError, match=r"s\.zarr: holds no usable sample yet, so there is nothing to show") as caught:
        write_figures(Store.open(tmp_path / "s.zarr"), tmp_path / "figures")
    assert caught.value.code == "store_empty"
    assert not (tmp_path / "figures").exists()
    assert inspect_store(Store.open(tmp_path / "s.zarr")).ok == 0


@pytest.mark.parametrize("name", ["checksum/c/0/0", "status/zarr.json", "checksum/zarr.json"])
def test_what_cannot_be_decoded_is_a_fault(store: Path, name: str) -> None:
    content = (store / name).read_bytes()
    (store / name).write_bytes(content[: len(content) // 2] if name.endswith(".json") else b"")
    assert "damaged" in faults(store)


@pytest.mark.parametrize("lost", ["configuration", "seed"])
def test_attributes_that_are_lost_are_faults(store: Path, lost: str) -> None:
    document = json.loads((store / "zarr.json").read_text())
    del document["attributes"][lost]
    (store / "zarr.json").write_text(json.dumps(document))
    assert f"attribute {lost} is missing" in faults(store)


def test_a_store_whose_own_metadata_is_damaged_is_refused_in_one_line(store: Path) -> None:
    document = json.loads((store / "zarr.json").read_text())
    layout = document["attributes"].pop("layout")
    (store / "zarr.json").write_text(json.dumps(document))
    with pytest.raises(StoreError, match="layout"):
        Store.open(store)
    document["attributes"]["layout"] = layout
    (store / "zarr.json").write_text(json.dumps(document)[:300])
    with pytest.raises(StoreError, match="damaged"):
        Store.open(store)


def test_a_mark_of_a_shard_that_is_none_is_passed_over(store: Path) -> None:
    (store / "checksum" / "c" / "9").mkdir()
    (store / "checksum" / "c" / "9" / "0").write_bytes(b"")
    assert faults(store) == ""


def test_a_damaged_column_is_told_by_inspect(store: Path) -> None:
    (store / "status" / "c" / "0").write_bytes(b"no such bytes")
    with pytest.raises(StoreError, match="damaged"):
        inspect_store(Store.open(store))
