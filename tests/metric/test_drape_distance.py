"""The paper's equations over an image distance, each render's features computed once."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from metric.backends import BACKEND_NAMES, Channel, get_backend
from metric.depth_rmse import DepthRmse
from metric.drape_distance import drape_distance
from metric.euclidean import squared_distance_table
from metric.feature_cache import FeatureCache, feature_key
from metric.render import DrapeRender
from simcore.errors import InputError
from simcore.scenes import Scene

MakeRender = Callable[..., DrapeRender]


class CountingBackend:
    """Mean grey as feature, absolute difference as distance."""

    name = "counting"
    channel = Channel.SHADED
    unit = ""
    fingerprint = "counting/1"

    def __init__(self) -> None:
        self.passes = 0

    def features(self, renders: Sequence[DrapeRender]) -> list[np.ndarray]:
        self.passes += len(renders)
        return [np.array([r.need_shaded().mean()], np.float64) for r in renders]

    def table(self, a: Sequence[np.ndarray], b: Sequence[np.ndarray]) -> np.ndarray:
        return np.abs(np.concatenate(a)[:, None] - np.concatenate(b)[None, :])


def sets(make: MakeRender, folds: float, count: int) -> dict[Scene, list[DrapeRender]]:
    return {
        Scene.HANGING: [make(folds, 0.1 * i) for i in range(count)],
        Scene.STRETCH: [make(folds + 0.5, 0.05 * i, 0.01) for i in range(count)],
    }


def test_mean_over_pairs_then_over_scenes(make_render: MakeRender) -> None:
    backend = CountingBackend()
    a, b = sets(make_render, 2.0, 3), sets(make_render, 4.0, 2)
    found = drape_distance(a, b, backend)
    for scene in Scene:
        pairs = [abs(x.need_shaded().mean() - y.need_shaded().mean()) for x in a[scene] for y in b[scene]]
        assert found.scenes[scene] == pytest.approx(np.mean(pairs))
    assert found.distance == pytest.approx(np.mean(list(found.scenes.values())))
    assert found.simulations == 2
    errors = [e for e in found.scene_errors.values() if e is not None]
    assert found.standard_error == pytest.approx(np.hypot(*errors) / 2)


def test_features_once_a_render(make_render: MakeRender) -> None:
    backend, cache = CountingBackend(), FeatureCache()
    a, b = sets(make_render, 2.0, 5), sets(make_render, 4.0, 5)
    drape_distance(a, b, backend, cache=cache)
    assert backend.passes == 20  # 2N a scene, not 2N²
    drape_distance(a, b, backend, cache=cache)
    assert backend.passes == 20


def test_features_are_kept_on_disk_by_content(make_render: MakeRender, tmp_path: Path) -> None:
    first = CountingBackend()
    FeatureCache(tmp_path).features(first, [make_render(2.0), make_render(3.0)])
    second = CountingBackend()
    values = FeatureCache(tmp_path).features(second, [make_render(3.0), make_render(2.0), make_render(4.0)])
    assert second.passes == 1
    assert values[0][0] == pytest.approx(make_render(3.0).need_shaded().mean())


def test_disk_cache_is_bounded(make_render: MakeRender, tmp_path: Path) -> None:
    cache = FeatureCache(tmp_path, disk_bytes=300)
    for folds in (1.0, 2.0, 3.0, 4.0):
        cache.features(CountingBackend(), [make_render(folds)])
    assert sum(p.stat().st_size for p in tmp_path.iterdir()) <= 300


def test_a_damaged_cache_file_is_computed_again(make_render: MakeRender, tmp_path: Path) -> None:
    FeatureCache(tmp_path).features(CountingBackend(), [make_render()])
    for path in tmp_path.glob("*.npy"):
        path.write_bytes(path.read_bytes()[:20])
    again = CountingBackend()
    FeatureCache(tmp_path).features(again, [make_render()])
    assert again.passes == 1


def test_a_cache_file_that_cannot_be_read_counts_as_absent(
    make_render: MakeRender, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of another user, on a disk that fails, or with a folder in its place."""
    first = CountingBackend()
    (tmp_path / f"{feature_key(first, make_render())}.npy").mkdir()
    monkeypatch.setattr(FeatureCache, "_write", lambda *_: None)  # what is in the way stays there
    FeatureCache(tmp_path).features(first, [make_render()])
    assert first.passes == 1


def test_features_of_heights_are_kept_apart_by_where_the_panel_is() -> None:
    backend, cache = get_backend("depth"), FeatureCache()
    near, far = np.zeros((64, 64), np.float32), np.zeros((64, 64), np.float32)
    near[10:50, 10:50], far[12:50, 10:50] = 0.84, 0.85

    def distance(panel_depth_m: float, kept: FeatureCache) -> float:
        pair = [DrapeRender(depth=depth, panel_depth_m=panel_depth_m) for depth in (near, far)]
        features = kept.features(backend, pair)
        return float(backend.table(features[:1], features[1:])[0, 0])

    alone = [distance(panel, FeatureCache()) for panel in (0.9, 1.2)]
    assert alone[0] != alone[1]
    assert [distance(panel, cache) for panel in (0.9, 1.2)] == alone


def test_self_distance_leaves_the_diagonal_out(make_render: MakeRender) -> None:
    a = sets(make_render, 2.0, 4)
    found = drape_distance(a, None, CountingBackend())
    table = found.tables[Scene.HANGING]
    assert found.scenes[Scene.HANGING] == pytest.approx(table[~np.eye(4, dtype=bool)].mean())


def test_nothing_to_compare(make_render: MakeRender) -> None:
    a = sets(make_render, 2.0, 1)
    with pytest.raises(InputError, match=r"at least 1 .*simulate more") as caught:
        drape_distance(a, {Scene.HANGING: []}, CountingBackend())
    assert caught.value.code == "renders_too_few"
    with pytest.raises(InputError, match=r"different scenes \(hanging, stretch and hanging\)") as caught:
        drape_distance(a, {Scene.HANGING: a[Scene.HANGING]}, CountingBackend())
    assert caught.value.code == "scenes_differ"
    with pytest.raises(InputError, match="at least 2") as caught:
        drape_distance(a, None, CountingBackend())
    assert caught.value.code == "renders_too_few"


def test_depth_rmse_is_the_plain_formula(make_render: MakeRender) -> None:
    a, b = make_render(2.0), make_render(3.0, 0.4)
    backend = DepthRmse()
    (table,) = backend.table(backend.features([a]), backend.features([b]))
    union = a.mask | b.mask
    assert table[0] == pytest.approx(np.sqrt(np.mean((a.height - b.height)[union].astype(float) ** 2)))


def test_squared_distances_are_exact_where_vectors_nearly_agree() -> None:
    rng = np.random.default_rng(0)
    base = rng.normal(0, 1, 150_001)  # more than one block
    near = [(base + 1e-3 * rng.normal(0, 1, base.size)).astype(np.float32) for _ in range(4)]
    table = squared_distance_table(near[:2], near[2:])
    expected = [[np.sum((x.astype(float) - y) ** 2) for y in near[2:]] for x in near[:2]]
    assert np.allclose(table, expected, rtol=1e-4)


def test_unknown_backend_lists_the_known() -> None:
    with pytest.raises(InputError, match="depth") as caught:
        get_backend("ssimm")
    assert caught.value.code == "backend_unknown"
    assert "lpips" in BACKEND_NAMES


def test_another_process_may_remove_what_is_being_counted(
    make_render: MakeRender, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cache = FeatureCache(tmp_path, disk_bytes=0)
    backend = CountingBackend()
    cache.features(backend, [make_render(1.0)])
    whole = Path.stat

    def gone(path: Path, **more: bool) -> os.stat_result:
        if path.suffix == ".npy":
            raise FileNotFoundError(errno.ENOENT, "gone", str(path))
        return whole(path, **more)

    monkeypatch.setattr(Path, "stat", gone)
    cache.features(backend, [make_render(2.0)])


@pytest.mark.parametrize("name", ["depth", "ssim", "ms-ssim"])
def test_features_of_any_form_count_as_what_they_take(name: str, make_render: MakeRender) -> None:
    """SSIM's are lists of dataclasses."""
    backend, one = get_backend(name), FeatureCache()
    one.features(backend, [make_render(size=256)])
    assert one._held >= 4 * 256 * 256
    cache = FeatureCache(memory_bytes=3 * one._held)
    cache.features(backend, [make_render(3.0, 0.01 * number, size=256) for number in range(8)])
    assert len(cache._memory) == 3 and cache._held == 3 * one._held
