"""Image distances other than LPIPS: known formulas, and the same manners for all."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from metric.backends import Backend, distance, get_backend
from metric.feature_distance import FeatureDistance
from metric.normals import depth_normals
from metric.parameter_distance import ParameterDistance
from metric.render import DrapeRender
from metric.ssim import grey
from simcore.errors import InputError
from simcore.parameters import FabricParameters

MakeRender = Callable[..., DrapeRender]
NAMES = ("ssim", "ms-ssim", "psnr", "depth", "silhouette", "normals")


@pytest.mark.parametrize("name", NAMES)
def test_zero_for_the_same_symmetric_and_larger_for_less_alike(name: str, make_render: MakeRender) -> None:
    backend = get_backend(name)
    renders = [make_render(2.0, size=192), make_render(2.0, 0.15, size=192), make_render(2.0, 2.0, 0.05, size=192)]
    features = backend.features(renders)
    table = backend.table(features, features)
    assert table.shape == (3, 3)
    assert np.abs(np.diag(table)).max() < 1e-4
    every_pair = backend.table(features, list(features))
    assert np.allclose(every_pair, every_pair.T, atol=1e-9) and np.allclose(table, every_pair, atol=1e-9)
    assert table[0, 2] >= table[0, 1] >= 0
    if name != "silhouette":  # the outlines of the three are the same
        assert table[0, 2] > table[0, 1] > 0


@pytest.mark.parametrize("name", NAMES)
def test_pictures_of_different_size_are_refused(name: str, make_render: MakeRender) -> None:
    backend: Backend = get_backend(name)
    with pytest.raises(InputError) as caught:
        backend.features([make_render(size=192), make_render(size=224)])
    assert caught.value.code == "image_size"


@pytest.mark.parametrize("name", NAMES)
def test_each_says_which_picture_it_needs(name: str, make_render: MakeRender) -> None:
    backend = get_backend(name)
    full = make_render(size=192)
    one = DrapeRender(shaded=full.shaded) if backend.channel == "depth" else DrapeRender(depth=full.depth)
    with pytest.raises(InputError, match="render has none"):
        backend.features([one])


def test_ssim_equals_kornia(make_render: MakeRender) -> None:
    import torch
    from kornia.metrics import ssim

    a, b = make_render(2.0, size=192), make_render(2.3, 0.4, size=192)
    tensors = [torch.from_numpy(grey(r.need_shaded()))[None, None] for r in (a, b)]
    expected = ssim(*tensors, window_size=11, padding="valid").mean().item()
    assert 1.0 - distance(get_backend("ssim"), a, b) == pytest.approx(expected, abs=1e-5)


def test_ms_ssim_needs_room_for_five_scales(make_render: MakeRender) -> None:
    with pytest.raises(InputError, match="176"):
        get_backend("ms-ssim").features([make_render(size=160)])


def test_psnr_formula(make_render: MakeRender) -> None:
    a, b = make_render(2.0), make_render(3.0)
    mse = np.mean((a.need_shaded() / 255.0 - b.need_shaded() / 255.0) ** 2)
    assert 60.0 - distance(get_backend("psnr"), a, b) == pytest.approx(-10 * np.log10(mse), abs=1e-3)


def test_silhouette_of_half_an_outline(make_render: MakeRender) -> None:
    full = make_render()
    half = np.array(full.need_depth())
    rows = np.flatnonzero(full.mask.any(axis=1))
    half[rows[len(rows) // 2] :] = 0
    expected = 1.0 - (half > 0).sum() / full.mask.sum()
    assert distance(get_backend("silhouette"), full, DrapeRender(depth=half)) == pytest.approx(expected)


def test_normals_of_a_tilted_plane() -> None:
    """z = 0.9 + 0.5 x: the angle to the frontal plane is atan 0.5 wherever the whole neighbourhood is seen."""
    _, u = np.mgrid[0:128, 0:128]
    ray_x = (u - 127.5) / 320.0
    tilted = DrapeRender(depth=(0.9 / (1 - 0.5 * ray_x)).astype(np.float32))
    flat = DrapeRender(depth=np.full((128, 128), 0.9, np.float32))
    normals = depth_normals(tilted)
    inner = normals[1:-1, 1:-1]
    assert np.allclose(inner, [0.5 / np.sqrt(1.25), 0.0, -1 / np.sqrt(1.25)], atol=2e-3)
    assert not normals[0].any()
    assert distance(get_backend("normals"), tilted, flat) == pytest.approx(np.arctan(0.5), abs=2e-3)


def test_features_of_any_network(make_render: MakeRender) -> None:
    def extract(renders):  # type: ignore[no-untyped-def]
        return [np.array([r.height.mean(), r.height.std()], np.float32) * 1000 for r in renders]

    backend = FeatureDistance("trunk", extract, "v1")
    a, b = make_render(2.0), make_render(2.0, 0.0, 0.06)
    x, y = (v / np.linalg.norm(v) for v in extract([a, b]))
    assert distance(backend, a, b) == pytest.approx(float(np.linalg.norm(x - y)), abs=1e-6)
    for value in (np.nan, np.inf, 0.0):
        broken = FeatureDistance("trunk", lambda renders, value=value: [np.full(3, value, np.float32)], "v1")  # type: ignore[misc]
        with pytest.raises(InputError, match="trunk: the network gave no usable features") as caught:
            broken.features([a])
        assert caught.value.code == "features_not_finite"


def fabric(**changes: float) -> FabricParameters:
    base = {
        "stretch_warp": 300.0,
        "stretch_weft": 250.0,
        "stretch_bias": 80.0,
        "bending_warp": 2e-5,
        "bending_weft": 1e-5,
        "bending_bias": 1.5e-5,
        "density": 0.2,
    }
    return FabricParameters(**{**base, **changes})


def test_parameter_distance_counts_standard_deviations() -> None:
    rng = np.random.default_rng(0)
    population = [FabricParameters.from_array(fabric().as_array() * np.exp(rng.normal(0, 0.5, 7))) for _ in range(40)]
    found = ParameterDistance.of_population(population)
    one, other = fabric(), fabric(density=0.2 * float(np.exp(found.spread[6])))
    matrix = found.matrix([one, other])
    assert matrix[0, 1] == pytest.approx(1.0)
    assert matrix[0, 0] == 0
    linear = ParameterDistance.of_population(population, logarithmic=False)
    assert linear.matrix([one, fabric(density=0.2 + float(linear.spread[6]))])[0, 1] == pytest.approx(1.0)


def test_parameter_distance_needs_a_population() -> None:
    with pytest.raises(InputError, match="at least two fabrics") as caught:
        ParameterDistance.of_population([fabric()])
    assert caught.value.code == "population_too_small"
    with pytest.raises(InputError, match="every parameter varies") as caught:
        ParameterDistance.of_population([fabric(), fabric(density=0.3)])
    assert caught.value.code == "population_constant"
    assert ParameterDistance.of_prior().spread.shape == (7,)
