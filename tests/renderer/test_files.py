"""PLY and depth PNG files."""

from __future__ import annotations

import os
import struct
import zlib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from PIL.PngImagePlugin import PngImageFile

from renderer.atomic import write_atomically
from renderer.depth_png import dequantise_depth, quantise_depth, read_depth_png, write_depth_png
from renderer.picture import write_png
from renderer.ply import read_ply, write_ply
from simcore.errors import InputError
from tests.renderer.surfaces import drape_like


def test_ply_keeps_every_bit(tmp_path: Path) -> None:
    vertices, triangles = drape_like(20)
    vertices += np.random.default_rng(0).normal(size=vertices.shape) * 1e-13
    write_ply(tmp_path / "a.ply", vertices, triangles)
    write_ply(tmp_path / "b.ply", vertices, triangles)
    assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "b.ply").read_bytes()
    mesh = read_ply(tmp_path / "a.ply")
    assert np.array_equal(mesh.vertices, vertices)
    assert np.array_equal(mesh.triangles, triangles)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.ply", "b.ply"]


def test_open3d_reads_our_ply(tmp_path: Path) -> None:
    import open3d as o3d

    vertices, triangles = drape_like(10)
    write_ply(tmp_path / "a.ply", vertices, triangles)
    mesh = o3d.io.read_triangle_mesh(str(tmp_path / "a.ply"))
    assert np.array_equal(np.asarray(mesh.vertices), vertices)
    assert np.array_equal(np.asarray(mesh.triangles), triangles)


def test_damaged_and_foreign_ply_are_refused(tmp_path: Path) -> None:
    vertices, triangles = drape_like(5)
    path = tmp_path / "a.ply"
    write_ply(path, vertices, triangles)
    content = path.read_bytes()
    for bad in (content[:-1], content[:60], b"", b"PLY", content.replace(b"double", b"float"), content + b"x"):
        path.write_bytes(bad)
        with pytest.raises(InputError) as error:
            read_ply(path)
        assert error.value.code == "ply_unreadable"
    with pytest.raises(InputError, match="No such file") as error:
        read_ply(tmp_path / "none.ply")
    assert error.value.code == "ply_missing"


def test_a_bad_mesh_or_folder_leaves_no_file(tmp_path: Path) -> None:
    vertices, triangles = drape_like(5)
    with pytest.raises(InputError):
        write_ply(tmp_path / "a.ply", vertices * np.nan, triangles)
    with pytest.raises(InputError) as error:
        write_ply(tmp_path / "no" / "a.ply", vertices, triangles)
    assert error.value.code == "cannot_write"
    assert list(tmp_path.iterdir()) == []


def test_a_pipe_is_no_depth_picture(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.png")
    with pytest.raises(InputError, match="no file") as error:
        read_depth_png(tmp_path / "pipe.png")
    assert error.value.code == "depth_missing"


def test_depth_survives_within_half_a_unit(tmp_path: Path) -> None:
    depth = np.random.default_rng(1).uniform(0.3, 1.5, (48, 64)).astype(np.float32)
    depth[:5] = 0.0
    path = tmp_path / "d.png"
    write_depth_png(path, depth, 1e-4)
    read = read_depth_png(path, 1e-4)
    assert read.dtype == np.float32
    np.testing.assert_allclose(read, depth, rtol=0, atol=0.5e-4 + 1e-7)
    assert np.all(read[:5] == 0.0)
    counts = quantise_depth(depth, 1e-4)
    assert np.array_equal(quantise_depth(dequantise_depth(counts, 1e-4), 1e-4), counts)


def test_every_count_survives() -> None:
    counts = np.arange(65536, dtype=np.uint16)
    for unit in (1e-4, 1e-3, 0.000125, 2.5e-4):
        assert np.array_equal(quantise_depth(dequantise_depth(counts, unit), unit), counts)


def test_depth_that_does_not_fit_names_the_unit(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"0\.0001 m.*depth_unit_m") as error:
        write_depth_png(tmp_path / "d.png", np.full((2, 2), 7.0), 1e-4)
    assert error.value.code == "depth_overflow"
    assert not (tmp_path / "d.png").exists()
    for bad in (-0.1, np.nan, np.inf):
        with pytest.raises(InputError, match="write 0 where there is no data") as error:
            write_depth_png(tmp_path / "d.png", np.full((2, 2), bad))
        assert error.value.code == "depth_invalid"
    with pytest.raises(InputError, match="no data: use a smaller depth_unit_m") as error:
        write_depth_png(tmp_path / "d.png", np.full((2, 2), 1e-5), 1e-4)
    assert error.value.code == "depth_unit"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("depth_m", "unit_m"), [(6.8, 1e-4), (65.9, 1e-3), (6.5536, 1e-4), (700.0, 1e-4)])
def test_the_unit_that_is_advised_fits(depth_m: float, unit_m: float) -> None:
    depth = np.full((2, 2), depth_m)
    with pytest.raises(InputError) as error:
        quantise_depth(depth, unit_m)
    advised = float(str(error.value).rpartition(" ")[2])
    assert unit_m < advised < 1.1 * depth_m / 65535
    assert quantise_depth(depth, advised).max() > 59_000


def test_damaged_and_foreign_pictures_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "d.png"
    write_depth_png(path, np.random.default_rng(0).uniform(0.5, 1.0, (64, 64)))
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(InputError) as error:
        read_depth_png(path)
    assert error.value.code == "depth_damaged"
    path.write_bytes(b"not a picture")
    with pytest.raises(InputError) as error:
        read_depth_png(path)
    assert error.value.code == "depth_not_png"
    write_png(path, np.zeros((8, 8), np.uint8))
    with pytest.raises(InputError) as error:
        read_depth_png(path)
    assert error.value.code == "depth_not_16_bit"


def test_a_picture_of_two_sizes_is_refused_before_it_is_decoded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first header is what a size is judged by, the last what is decoded."""
    path = tmp_path / "d.png"
    write_depth_png(path, np.full((8, 8), 0.9))
    small = path.read_bytes()
    header = b"IHDR" + struct.pack(">II", 9000, 9000) + small[24:29]
    again = struct.pack(">I", 13) + header + struct.pack(">I", zlib.crc32(header))
    path.write_bytes(small[:33] + again + small[33:])
    monkeypatch.setattr(PngImageFile, "load", lambda self: pytest.fail("it was decoded"))
    with pytest.raises(InputError, match="8 x 8 pixels by its first header, 9000 x 9000 by a later one") as caught:
        read_depth_png(path)
    assert caught.value.code == "depth_damaged"


def test_reads_a_real_capture(shared_dir: Path) -> None:
    depth = read_depth_png(shared_dir / "real" / "phisft-r1" / "r1-hanging-0.png", 1e-4)
    assert depth.shape == (480, 640)
    assert 1.1 < np.median(depth[depth > 0]) < 1.3


def test_a_link_stays_a_link_and_a_pipe_a_pipe(tmp_path: Path) -> None:
    vertices, triangles = drape_like(5)
    write_ply(tmp_path / "a.ply", vertices, triangles)
    link = tmp_path / "link.ply"
    link.symlink_to(tmp_path / "real.ply")
    write_ply(link, vertices, triangles)
    assert link.is_symlink() and (tmp_path / "real.ply").read_bytes() == (tmp_path / "a.ply").read_bytes()
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with ThreadPoolExecutor(1) as pool:
        read = pool.submit(pipe.read_bytes)
        write_ply(pipe, vertices, triangles)
        assert read.result() == (tmp_path / "a.ply").read_bytes()
    assert pipe.is_fifo()


def test_the_longest_file_name_can_be_written(tmp_path: Path) -> None:
    write_atomically(tmp_path / ("n" * 255), b"x")
    with pytest.raises(InputError, match="too long") as caught:
        write_atomically(tmp_path / ("n" * 256), b"x")
    assert caught.value.code == "cannot_write"
    assert [path.name for path in tmp_path.iterdir()] == ["n" * 255]


def test_an_interrupted_write_leaves_the_old_file_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_atomically(tmp_path / "kept", b"old")

    def interrupted(number: int) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_atomically(tmp_path / "kept", b"new")
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [("kept", b"old")]
