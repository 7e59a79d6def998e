"""The store's contract: what is written comes back, whole shards only, and clear lines where a place fails."""

from __future__ import annotations

import errno
import json
import os
import pickle
from pathlib import Path

import numpy as np
import pytest
import zarr

from renderer.store import RowStatus, ShardRows, Store, StoreLayout, StoreWriter
from renderer.store_location import store_errors, store_exists
from renderer.store_remote import patience_s
from simcore.errors import DrapemeterError, InputError, StoreError

LAYOUT = StoreLayout(
    materials=3,
    scenes=("hanging", "stretch"),
    jitters=1,
    inclinations_deg=(-5.0, 5.0),
    simulations_per_shard=4,
    vertex_count=25,
    picture_size=(32, 32),
)


def rows_of(layout: StoreLayout, shard: int) -> ShardRows:
    """Rows whose values tell where they belong."""
    rng = np.random.default_rng(shard)
    simulations = layout.shard_simulations(shard)
    address = np.repeat([layout.address(s) for s in simulations], layout.pictures, axis=0)
    count = len(address)
    status = np.full(count, RowStatus.OK, np.uint8)
    status[-1] = RowStatus.DIVERGED
    reason = np.array([""] * (count - 1) + ["forces grew without bound"], dtype=object)
    return ShardRows(
        depth=rng.integers(8000, 9001, (count, *layout.picture_size), dtype=np.uint16),
        parameters=np.repeat(address[:, :1], 7, axis=1).astype(np.float32),
        scene=address[:, 1].astype(np.uint8),
        status=status,
        reason=reason,
        inclination_deg=np.tile(layout.inclinations_deg, len(simulations)).astype(np.float32),
        seed=np.arange(count, dtype=np.uint64) + np.uint64(2**63),
        material=address[:, 0].astype(np.uint32),
        jitter=address[:, 2].astype(np.uint32),
        vertices=rng.normal(size=(len(simulations), layout.vertex_count, 3)).astype(np.float32),
        residual=rng.random(len(simulations)),
        energy=rng.random(len(simulations)),
    )


def make(url: str | Path, layout: StoreLayout = LAYOUT, shards: tuple[int, ...] | None = None) -> StoreWriter:
    """A store with the given shards written (all by default)."""
    writer = StoreWriter.create(url, layout, configuration={"x": 1}, seed=7, software_version="0")
    for shard in range(layout.shards) if shards is None else shards:
        writer.write_shard(shard, rows_of(layout, shard))
    return writer


def test_layout_counts_rows_and_shards() -> None:
    assert (LAYOUT.simulations, LAYOUT.samples, LAYOUT.shards) == (6, 12, 2)
    assert [list(LAYOUT.shard_rows(s)) for s in range(2)] == [list(range(8)), list(range(8, 12))]
    assert [LAYOUT.address(s) for s in (0, 1, 2, 5)] == [(0, 0, 0), (0, 1, 0), (1, 0, 0), (2, 1, 0)]


def test_what_is_written_comes_back(tmp_path: Path) -> None:
    make(tmp_path / "s.zarr")
    store = Store.open(tmp_path / "s.zarr")
    expected = ShardRows.concatenate([rows_of(LAYOUT, 0), rows_of(LAYOUT, 1)])
    assert len(store) == 12 and store.shards == 2 and store.complete.all()
    assert np.array_equal(store.parameters, expected.parameters)
    assert np.array_equal(store.materials, expected.material)
    assert store.scene.tolist() == ["hanging", "hanging", "stretch", "stretch"] * 3
    assert store.ok.sum() == 10 and store.reason[7] == "forces grew without bound"
    assert np.array_equal(store.column("seed"), expected.seed)
    assert np.array_equal(store.vertices(5), expected.vertices[5])
    assert store.depth(9) == pytest.approx(expected.depth[9] * 1e-4)
    assert np.array_equal(store.depth_counts(1), expected.depth[8:])
    again = store.read_shard(0)
    for name, value in vars(rows_of(LAYOUT, 0)).items():
        assert np.array_equal(getattr(again, name), value), name
    assert store.attributes["seed"] == 7 and store.attributes["configuration"] == {"x": 1}


def test_any_zarr_reader_finds_the_contract(tmp_path: Path) -> None:
    make(tmp_path / "s.zarr")
    metadata = json.loads((tmp_path / "s.zarr" / "depth" / "zarr.json").read_text())
    sharding = metadata["codecs"][0]
    assert metadata["zarr_format"] == 3 and metadata["data_type"] == "uint16"
    assert sharding["name"] == "sharding_indexed" and sharding["configuration"]["chunk_shape"] == [1, 32, 32]
    codecs = sharding["configuration"]["codecs"]
    assert [c["name"] for c in codecs] == ["numcodecs.delta", "bytes", "blosc"]
    assert codecs[2]["configuration"]["cname"] == "zstd" and codecs[2]["configuration"]["shuffle"] == "bitshuffle"
    group = zarr.open_group(tmp_path / "s.zarr", mode="r")
    for name in ("depth", "parameters", "scene", "status", "inclination_deg", "seed", "material", "jitter"):
        assert group[name].shape[0] == 12
    assert group["drapes/vertices"].dtype == np.float32


def test_part_of_a_shard_is_refused_and_nothing_written(tmp_path: Path) -> None:
    writer = make(tmp_path / "s.zarr", shards=())
    part = rows_of(LAYOUT, 0)
    part = ShardRows(**{name: value[: len(value) // 2] for name, value in vars(part).items()})
    with pytest.raises(StoreError, match="whole shards only") as raised:
        writer.write_shard(0, part)
    assert raised.value.code == "partial_shard"
    assert not list((tmp_path / "s.zarr" / "depth").glob("c/*"))


def test_the_last_shard_takes_its_fewer_rows_and_no_more(tmp_path: Path) -> None:
    writer = make(tmp_path / "s.zarr", shards=())
    with pytest.raises(StoreError) as raised:
        writer.write_shard(1, rows_of(LAYOUT, 0))
    assert raised.value.code == "partial_shard"
    for shard in (2, -1):
        with pytest.raises(StoreError, match=f"shard {shard} is not one of the store's 2") as raised:
            writer.write_shard(shard, rows_of(LAYOUT, 1))
        assert raised.value.code == "shard_unknown"
    assert not Store.open(tmp_path / "s.zarr").complete.any()
    writer.write_shard(1, rows_of(LAYOUT, 1))
    assert Store.open(tmp_path / "s.zarr").complete.tolist() == [False, True]


def test_writers_of_different_shards_do_not_disturb_each_other(tmp_path: Path) -> None:
    make(tmp_path / "a.zarr")
    make(tmp_path / "b.zarr", shards=())
    for shard in (1, 0):
        StoreWriter.open(tmp_path / "b.zarr").write_shard(shard, rows_of(LAYOUT, shard))
    assert files(tmp_path / "a.zarr") == files(tmp_path / "b.zarr")


def files(folder: Path) -> dict[str, bytes]:
    """Every file below a folder by its relative path."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_unfinished_shards_read_as_missing(tmp_path: Path) -> None:
    make(tmp_path / "s.zarr", shards=(1,))
    store = Store.open(tmp_path / "s.zarr")
    assert store.complete.tolist() == [False, True]
    assert (store.status[:8] == RowStatus.MISSING).all() and not store.ok[:8].any()
    assert not store.depth(0).any()


def test_rows_of_a_shard_that_is_being_written_may_not_be_used(tmp_path: Path) -> None:
    make(tmp_path / "s.zarr")
    (mark,) = (tmp_path / "s.zarr" / "checksum" / "c" / "0").iterdir()
    mark.unlink()
    store = Store.open(tmp_path / "s.zarr")
    assert (store.status[:6] == RowStatus.OK).any() and not store.ok[:8].any() and store.ok[8:].any()


@pytest.mark.parametrize("name", ["depth/c/0/0/0", "drapes/vertices/c/0/0/0"])
def test_a_shard_with_a_damaged_object_is_written_again(name: str, tmp_path: Path) -> None:
    make(tmp_path / "s.zarr")
    sound = files(tmp_path / "s.zarr")
    (tmp_path / "s.zarr" / name).write_bytes(sound[name][:-20])
    (tmp_path / "s.zarr" / "checksum" / "c" / "0" / "0").unlink()
    StoreWriter.open(tmp_path / "s.zarr").write_shard(0, rows_of(LAYOUT, 0))
    assert files(tmp_path / "s.zarr") == sound


def test_the_status_of_a_damaged_shard_is_no_status(tmp_path: Path) -> None:
    make(tmp_path / "s.zarr")
    (chunk,) = (path for path in (tmp_path / "s.zarr" / "status" / "c").rglob("0") if path.is_file())
    chunk.write_bytes(chunk.read_bytes()[:-4])
    with pytest.raises(StoreError, match="damaged") as caught:
        StoreWriter.open(tmp_path / "s.zarr").status(0)
    assert caught.value.code == "store_damaged"


def test_a_store_travels_to_a_worker_by_its_url(tmp_path: Path) -> None:
    make(tmp_path / "s.zarr")
    there = pickle.loads(pickle.dumps(Store.open(tmp_path / "s.zarr")))
    assert np.array_equal(there.depth(3), Store.open(tmp_path / "s.zarr").depth(3))


def test_places_that_are_taken_or_empty_are_named(tmp_path: Path) -> None:
    make(tmp_path / "s.zarr")
    with pytest.raises(InputError, match="--resume") as raised:
        make(tmp_path / "s.zarr")
    assert raised.value.code == "store_exists"
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "thesis.txt").write_text("mine")
    with pytest.raises(InputError, match="no store"):
        make(tmp_path / "folder")
    with pytest.raises(InputError, match="no store there"):
        Store.open(tmp_path / "none.zarr")
    zarr.open_group(tmp_path / "other.zarr", mode="w", attributes={"schema": "somebody-else/3"})
    with pytest.raises(StoreError, match="somebody-else/3"):
        Store.open(tmp_path / "other.zarr")


def test_a_store_killed_at_its_start_is_laid_out_anew(tmp_path: Path) -> None:
    zarr.open_group(tmp_path / "s.zarr", mode="w").create_array("depth", shape=(3,), dtype="u1")
    (tmp_path / "s.zarr" / "depth" / "zarr.0a1b.partial").write_text("{")  # in the middle of an object
    assert not store_exists(tmp_path / "s.zarr")
    make(tmp_path / "s.zarr")
    assert Store.open(tmp_path / "s.zarr").complete.all()


def test_somebodys_own_group_is_not_laid_out_anew(tmp_path: Path) -> None:
    group = zarr.open_group(tmp_path / "mine.zarr", mode="w", zarr_format=3)
    group.create_array("depth", shape=(5, 4), dtype="f4")[:] = 7
    with pytest.raises(InputError, match="is no store"):
        make(tmp_path / "mine.zarr")
    assert (zarr.open_group(tmp_path / "mine.zarr", mode="r")["depth"][:] == 7).all()


def test_a_store_whose_attributes_are_lost_is_not_laid_out_anew(tmp_path: Path) -> None:
    make(tmp_path / "s.zarr")
    (tmp_path / "s.zarr" / "zarr.json").write_text('{"zarr_format": 3, "node_type": "group"}')
    with pytest.raises(InputError, match=r"zarr\.json is lost"):
        make(tmp_path / "s.zarr")


@pytest.mark.parametrize("text", ["[]", "null", "3", '{"zarr_format": 3, "node_type": "group", "attributes": []}'])
def test_a_root_that_is_no_group_is_damage(text: str, tmp_path: Path) -> None:
    make(tmp_path / "s.zarr")
    (tmp_path / "s.zarr" / "zarr.json").write_text(text)
    with pytest.raises(StoreError) as caught:
        Store.open(tmp_path / "s.zarr")
    assert caught.value.code in {"store_damaged", "store_schema"}


@pytest.mark.parametrize(("name", "value"), [("seed", "7"), ("configuration", None), ("software_version", 1)])
def test_attributes_of_another_kind_are_damage(name: str, value: object, tmp_path: Path) -> None:
    make(tmp_path / "s.zarr")
    zarr.open_group(tmp_path / "s.zarr", mode="r+").attrs.update({name: value})
    store = Store.open(tmp_path / "s.zarr")
    with pytest.raises(StoreError, match=f"attribute {name}"):
        _ = store.stated


@pytest.mark.parametrize("url", ["file:/tmp/x.zarr", "file://localhost/tmp/x.zarr", "memory:///x"])
def test_urls_that_would_go_elsewhere_are_refused(url: str) -> None:
    with pytest.raises(InputError, match="not a place for a store: name a folder") as raised:
        store_exists(url)
    assert raised.value.code == "store_url"


@pytest.mark.parametrize("url", ["s3:/bucket/x", Path("s3://bucket/x"), "gs:/bucket"])
def test_an_object_stores_url_with_a_slash_too_few_is_no_folder(url: str | Path) -> None:
    with pytest.raises(InputError, match=r"write (s3|gs)://bucket") as raised:
        store_exists(url)
    assert raised.value.code == "store_url"


@pytest.mark.parametrize(
    ("number", "kind", "code"),
    [
        (errno.ENOSPC, StoreError, "store_no_space"),
        (errno.EDQUOT, StoreError, "store_no_space"),
        (errno.EACCES, InputError, "store_not_permitted"),
        (errno.EROFS, InputError, "store_not_permitted"),
    ],
)
def test_a_full_place_is_a_failure_and_a_forbidden_one_bad_input(
    number: int, kind: type[DrapemeterError], code: str
) -> None:
    with pytest.raises(kind) as raised, store_errors("here"):
        raise OSError(number, os.strerror(number))
    assert raised.value.code == code


@pytest.mark.parametrize(("named", "seconds"), [("3.5", 3.5), ("0", 0.0), ("", 120.0)])
def test_requests_are_repeated_for_as_long_as_is_said(
    named: str, seconds: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DRAPEMETER_STORE_RETRY_S", named)
    assert patience_s() == seconds


@pytest.mark.parametrize("named", ["abc", "-1", "nan", "inf", "1e12"])
def test_a_patience_that_is_none_is_refused(named: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DRAPEMETER_STORE_RETRY_S", named)
    with pytest.raises(InputError, match=f"DRAPEMETER_STORE_RETRY_S is '{named}': give the seconds") as raised:
        store_exists("s3://bucket/s.zarr")
    assert raised.value.code == "setting_invalid"


def test_a_disk_that_fails_is_the_stores_fault() -> None:
    with pytest.raises(StoreError, match=r"here: cannot be read .*Input/output error") as raised, store_errors("here"):
        raise OSError(errno.EIO, os.strerror(errno.EIO))
    assert raised.value.code == "store_failed"


def test_a_file_in_the_way_of_a_store_stays_as_it_is(tmp_path: Path) -> None:
    (tmp_path / "notes").write_text("mine")
    with pytest.raises(InputError, match="a file or folder is in the way; choose another place") as raised:
        make(tmp_path / "notes" / "s.zarr")
    assert raised.value.code == "store_in_the_way"
    assert (tmp_path / "notes").read_text() == "mine" and len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize(
    ("change", "place"), [({"materials": 0}, "materials"), ({"scenes": []}, "scenes"), ({"colour": "red"}, "colour")]
)
def test_a_layout_that_is_none_is_damage(change: dict[str, object], place: str, tmp_path: Path) -> None:
    make(tmp_path / "s.zarr")
    group = zarr.open_group(tmp_path / "s.zarr", mode="r+")
    group.attrs.update({"layout": {**LAYOUT.model_dump(mode="json"), **change}})
    with pytest.raises(StoreError, match=f"layout is damaged at {place}: ") as raised:
        Store.open(tmp_path / "s.zarr")
    assert raised.value.code == "store_layout"


def test_an_unknown_url_is_refused() -> None:
    with pytest.raises(InputError, match="not a place for a store") as raised:
        Store.open("gopher://x/y")
    assert raised.value.code == "store_url"
