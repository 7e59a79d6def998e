"""Capture sets that the tests of the diagnosis share: two fabrics in ``stretch`` on 20 mm meshes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from capture.capture_set import CaptureSet
from diagnosis.diagnose import Diagnosis, DiagnosisOptions, diagnose
from diagnosis.effects import parse_effect
from diagnosis.simulation.drape_cache import DrapeCache
from diagnosis.synthesis import SynthesisPlan, draw_fabrics, make_capture_set
from simcore.mechanics import Jitter

CANDIDATES = ("air_draft", "depth_scale", "panel_adhesion", "pin_spacing", "range_noise")
PLAN = SynthesisPlan(
    fabrics=2, scenes=("stretch",), resolution_m=0.02, jitter=Jitter(1.0, 0.0004, 0.02), seed=41, pin_radius_m=0.0
)

MakeSet = Callable[..., CaptureSet]
Diagnose = Callable[..., Diagnosis]


@pytest.fixture(scope="session")
def shelf(tmp_path_factory: pytest.TempPathFactory) -> DrapeCache:
    """One cache of simulations for all tests of the room."""
    return DrapeCache(tmp_path_factory.mktemp("drapes"))


@pytest.fixture(scope="session")
def make_set(tmp_path_factory: pytest.TempPathFactory, shelf: DrapeCache) -> MakeSet:
    """``make_set("air_draft=0.3", ...)``: a capture set with these effects."""

    def make(*effects: str) -> CaptureSet:
        fabrics = dict(enumerate(draw_fabrics(2, PLAN.seed)))
        folder: Path = tmp_path_factory.mktemp("set")
        return make_capture_set(folder, PLAN, [parse_effect(text) for text in effects], fabrics=fabrics, cache=shelf)

    return make


@pytest.fixture(scope="session")
def explain(shelf: DrapeCache) -> Diagnose:
    """Diagnose a set with a few effects."""

    def run(captures: CaptureSet, *, effects: tuple[str, ...] = CANDIDATES, workers: int = 1) -> Diagnosis:
        options = DiagnosisOptions(effects=effects, resolution_m=0.02, workers=workers)
        return diagnose(captures, options, cache=shelf)

    return run
