"""Shaded pictures: the light, determinism, and agreement of both engines with the depth picture."""

from __future__ import annotations

import math
import os
import signal
import threading
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from renderer import filament
from renderer.camera import CANONICAL_CAMERA, Camera, frontal_pose
from renderer.depth import render_buffers
from renderer.light import Light, encode_srgb
from renderer.pose import inclination_pose
from renderer.shade import ShadedRenderer, shade_lambertian_raycast
from simcore.errors import DrapemeterError, InputError, MissingResourceError
from tests.renderer.surfaces import drape_like, height_field

POSE = frontal_pose()
ENGINES = ("raycast", "filament")
DRIVER_FOLDERS = (Path("/usr/share/vulkan/icd.d"), Path("/etc/vulkan/icd.d"))


def vulkan_drivers() -> bool:
    """Whether a Vulkan driver is named, or one is installed where drivers are looked for."""
    if os.environ.get("VK_DRIVER_FILES") or os.environ.get("VK_ICD_FILENAMES"):
        return True
    return any(path.suffix == ".json" for folder in DRIVER_FOLDERS if folder.is_dir() for path in folder.iterdir())


@pytest.fixture(scope="module")
def vulkan() -> None:
    """Skips where no Vulkan driver is installed; where one is, a renderer that does not start fails the test."""
    if not vulkan_drivers():
        pytest.skip("no Vulkan driver here: scripts/system-packages.sh")
    filament.filament_process().start(256, 256)


def pictures(engine: str, supersample: int = 1) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    vertices, triangles = drape_like()
    uv = np.zeros((len(vertices), 2))
    shaded = ShadedRenderer(CANONICAL_CAMERA, engine=engine, supersample=supersample).render(
        vertices, triangles, uv, POSE, 2.0
    )
    cloth = render_buffers(vertices, triangles, CANONICAL_CAMERA, POSE @ inclination_pose(2.0), panel=False).cloth
    return shaded, cloth


def test_srgb_encoding_of_known_values() -> None:
    assert encode_srgb(np.array([0.0, 0.2158605, 1.0, 2.0])).tolist() == [0, 128, 255, 255]


def test_lamberts_law() -> None:
    """A plane square to the light is brightest; one turned by 60 degrees sends half the direct light."""
    light = Light(azimuth_deg=0.0, elevation_deg=0.0)
    camera = Camera(32, 32, 400.0, 400.0, 15.5, 15.5)

    def middle(slope: float) -> int:
        mesh = height_field(lambda x, y: 0.2 + slope * x)
        return int(shade_lambertian_raycast(*mesh, camera, POSE, light=light)[16, 16])

    with pytest.raises(DrapemeterError):  # fills the picture evenly
        middle(0.0)
    camera = Camera(320, 320, 400.0, 400.0, 159.5, 159.5)
    mesh = height_field(lambda x, y: np.zeros_like(x))
    assert shade_lambertian_raycast(*mesh, camera, POSE, light=light)[160, 160] == encode_srgb(
        np.array([0.9 * (0.15 + 0.8)])
    )
    steep = height_field(lambda x, y: np.sqrt(3.0) * (x + 0.25), x=(-0.1, 0.1))
    assert shade_lambertian_raycast(*steep, camera, POSE, light=light)[160, 160] == encode_srgb(
        np.array([0.9 * (0.15 + 0.4)])
    )


def test_light_comes_from_the_upper_right() -> None:
    camera = CANONICAL_CAMERA
    ball = height_field(lambda x, y: np.sqrt(np.maximum(0.0, 0.2**2 - x**2 - (y + 0.25) ** 2)), x=(-0.2, 0.2))
    picture = shade_lambertian_raycast(*ball, camera, POSE).astype(int)
    row, column = np.unravel_index(np.argmax(picture), picture.shape)
    assert row < 128
    assert column > 128


@pytest.mark.parametrize("engine", ENGINES)
def test_outline_agrees_with_depth(engine: str, request: pytest.FixtureRequest) -> None:
    if engine == "filament":
        request.getfixturevalue("vulkan")
    shaded, cloth = pictures(engine)
    lit = shaded > 0
    assert (lit & cloth).sum() / (lit | cloth).sum() > 0.999
    for axis in (0, 1):
        for picture in (lit, cloth):
            assert picture.any()
        ours, theirs = np.flatnonzero(lit.any(axis)), np.flatnonzero(cloth.any(axis))
        assert abs(ours[0] - theirs[0]) <= 1
        assert abs(ours[-1] - theirs[-1]) <= 1


@pytest.mark.usefixtures("vulkan")
def test_both_engines_draw_the_same_picture() -> None:
    ray, ray_cloth = pictures("raycast")
    lit, _ = pictures("filament")
    difference = np.abs(ray.astype(int) - lit.astype(int))[ray_cloth & (lit > 0)]
    assert np.percentile(difference, 99) <= 2
    assert difference.mean() < 0.7


def test_the_wrinkles_of_stretch_show() -> None:
    """Ridges from the upper left to the lower right must not lie along the light."""
    ridges = height_field(lambda x, y: 0.02 + 0.004 * np.sin(60.0 * (x + y)), cells=200)
    across = height_field(lambda x, y: 0.02 + 0.004 * np.sin(60.0 * (x - y)), cells=200)
    shown, hidden = (
        shade_lambertian_raycast(*mesh, CANONICAL_CAMERA, POSE)[100:160, 100:160] for mesh in (ridges, across)
    )
    assert shown.std() > 2.0 * hidden.std()


def test_same_bits_every_time() -> None:
    first, _ = pictures("raycast", 2)
    for _ in range(3):
        assert np.array_equal(first, pictures("raycast", 2)[0])


def test_supersampling_softens_only_the_outline() -> None:
    fine, cloth = pictures("raycast", 4)
    coarse, _ = pictures("raycast", 1)
    inner = cloth.copy()
    for shift in (-1, 1):
        inner &= np.roll(cloth, shift, 0) & np.roll(cloth, shift, 1)
    difference = np.abs(fine.astype(int) - coarse.astype(int))
    assert np.percentile(difference[inner], 99) <= 3
    assert difference[~inner].max() > 30


@pytest.mark.parametrize("engine", ENGINES)
def test_a_constant_picture_is_an_error(engine: str, request: pytest.FixtureRequest) -> None:
    if engine == "filament":
        request.getfixturevalue("vulkan")
    vertices, triangles = drape_like()
    with pytest.raises(DrapemeterError) as error:
        ShadedRenderer(CANONICAL_CAMERA, engine=engine, supersample=1).render(
            vertices + np.array([9.0, 0.0, 0.0]), triangles, None, POSE
        )
    assert error.value.code == "picture_constant"


def test_bad_input_is_refused() -> None:
    vertices, triangles = drape_like(10)
    with pytest.raises(InputError, match="'opengl': choose raycast or filament") as caught:
        ShadedRenderer(CANONICAL_CAMERA, engine="opengl")
    assert caught.value.code == "engine_unknown"
    for supersample in (0, 9):
        with pytest.raises(InputError, match=f"supersampling {supersample} must be from 1 to 8") as caught:
            ShadedRenderer(CANONICAL_CAMERA, supersample=supersample)
        assert caught.value.code == "supersample"
    with pytest.raises(InputError, match="raycast"):
        ShadedRenderer(Camera(64, 64, 50.0, 50.0, 32.0, 32.0, (0.1, 0.0, 0.0, 0.0, 0.0)), engine="filament")
    with pytest.raises(InputError):
        shade_lambertian_raycast(vertices * np.nan, triangles, CANONICAL_CAMERA, POSE)


@pytest.mark.parametrize(
    "bad", [{"direct": 1.5}, {"ambient": -0.1}, {"direct": math.nan}, {"albedo": math.nan}, {"azimuth_deg": math.inf}]
)
def test_light_that_cannot_be_is_refused(bad: dict[str, float]) -> None:
    with pytest.raises(InputError, match=r"give finite angles, .*albedo \(direct \+ ambient\) of at most 1") as caught:
        Light(**bad)
    assert caught.value.code == "light"


@pytest.mark.usefixtures("vulkan")
def test_filament_draws_from_any_thread_and_writes_nothing_to_standard_output(
    capfd: pytest.CaptureFixture[str],
) -> None:
    expected, _ = pictures("filament")
    drawn: list[NDArray[np.uint8]] = []
    threads = [threading.Thread(target=lambda: drawn.append(pictures("filament")[0])) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(drawn) == 3
    assert all(np.array_equal(picture, expected) for picture in drawn)
    assert capfd.readouterr().out == ""


@pytest.mark.usefixtures("vulkan")
def test_a_grown_renderer_is_replaced(monkeypatch: pytest.MonkeyPatch) -> None:
    expected, _ = pictures("filament")
    before = filament.filament_process().pid
    monkeypatch.setattr(filament, "MAX_GROWTH_MB", -1.0)
    assert np.array_equal(pictures("filament")[0], expected)
    monkeypatch.undo()
    assert np.array_equal(pictures("filament")[0], expected)
    assert filament.filament_process().pid != before


@pytest.mark.usefixtures("vulkan")
def test_a_renderer_that_dies_is_an_error_and_the_next_one_works() -> None:
    expected, _ = pictures("filament")
    process = filament.filament_process()
    assert process.pid is not None
    os.kill(process.pid, signal.SIGSTOP)
    killer = threading.Timer(0.3, os.kill, (process.pid, signal.SIGKILL))
    killer.start()
    with pytest.raises(DrapemeterError) as error:
        pictures("filament")
    assert error.value.code == "renderer_died"
    assert np.array_equal(pictures("filament")[0], expected)


def test_a_machine_without_vulkan_gets_one_clear_line(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("VK_DRIVER_FILES", "VK_ICD_FILENAMES"):
        monkeypatch.setenv(name, "/nonexistent")
    filament.filament_process().close()
    with pytest.raises(MissingResourceError, match="raycast") as error:
        ShadedRenderer(CANONICAL_CAMERA, engine="filament")
    assert error.value.code == "vulkan_missing"
    assert "\n" not in str(error.value)
