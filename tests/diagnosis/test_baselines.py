"""What the simpler methods answer, and that the noise they are held against is the noise as it is modelled."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from diagnosis.blind.answers import EXAMPLES_FOLDER, examples_of
from diagnosis.blind.baselines import baseline_answers, draw_noise, mmd_p, refitted_map
from diagnosis.blind.page import render_page
from diagnosis.blind.score import score
from diagnosis.effects import get_effect
from diagnosis.inference.block import Block, PixelBlock, View
from diagnosis.inference.evidence import Evidence
from diagnosis.inference.likelihood import LikelihoodModel
from diagnosis.shrinkage.held_out import refit
from diagnosis.simulation.sizes import node_weights
from simcore.errors import InputError
from tests.diagnosis.test_blind import DRAFT, answer

COUNT = 80
FABRICS = 4
SETS = 60


def block(fabric: int, scene: str = "stretch") -> Block:
    """Errors of half a millimetre that change slowly from cell to cell, seven parameters among them."""
    rng = np.random.default_rng(fabric)
    place = np.arange(COUNT) / COUNT
    smooth = np.exp(-0.5 * ((place[:, None] - place[None]) / 0.15) ** 2)
    jacobian = 2e-4 * rng.standard_normal((7, 3)) @ np.stack([np.sin(k * np.pi * place) for k in (1, 2, 3)])
    covariance = 2.5e-7 * smooth + 1e-9 * np.eye(COUNT) + jacobian.T @ jacobian
    view = View(np.zeros(COUNT), {}, {}, np.linalg.cholesky(covariance), 0.0)
    owner, still = np.zeros(COUNT, np.intp), np.zeros((4, COUNT))
    return Block(f"f{fabric}", scene, ("a",), view, view, np.arange(COUNT), owner, jacobian, still, still)


def showing(own: Block, whitened: np.ndarray) -> Block:
    return replace(own, stated=replace(own.stated, measured=whitened))


def noisy_sets(count: int) -> list[list[Block]]:
    """Sets in which nothing is but errors as modelled: smooth, of a scale of its own in every block."""
    rng = np.random.default_rng(5)
    spread = LikelihoodModel().spread_stretch
    return [
        [
            showing(block(fabric), np.exp(spread * rng.standard_normal()) * rng.standard_normal(COUNT))
            for fabric in range(FABRICS)
        ]
        for _ in range(count)
    ]


def test_errors_as_modelled_alarm_in_a_twentieth_of_the_sets() -> None:
    found = np.array([mmd_p(blocks) for blocks in noisy_sets(SETS)])
    assert np.count_nonzero(found < 0.05) <= 6  # of 60; more in 3 % of all seeds
    assert 0.3 < np.median(found) < 0.7


@pytest.mark.parametrize("kind", ["shift", "larger"])
def test_what_the_errors_do_not_explain_alarms(kind: str) -> None:
    for blocks in noisy_sets(8):
        changed = []
        for own in blocks:
            metres = own.metres(own.stated.measured)
            metres = metres + 0.003 if kind == "shift" else 8.0 * metres
            changed.append(showing(own, np.linalg.solve(own.stated.factor, metres)))
        assert mmd_p(changed) < 0.05


def test_the_same_set_gets_the_same_p_value() -> None:
    (blocks,) = noisy_sets(1)
    assert mmd_p(blocks) == mmd_p(blocks)


def test_parameters_are_refitted_in_draws_as_in_captures() -> None:
    own = block(1)
    whitened = np.random.default_rng(2).standard_normal(COUNT)
    found = refit(showing(own, whitened), np.zeros(COUNT))
    np.testing.assert_allclose(refitted_map(own) @ whitened, found.left, atol=1e-12)
    np.testing.assert_allclose(np.sum(refitted_map(own) ** 2, axis=1), found.variance, rtol=1e-6)
    assert np.linalg.norm(found.left) < np.linalg.norm(own.metres(whitened))


def test_drawn_errors_have_a_scale_of_their_own() -> None:
    model = LikelihoodModel()
    for scene, spread in (("stretch", model.spread_stretch), ("hanging", model.spread_hanging)):
        drawn = draw_noise(block(0, scene), 4000, np.random.default_rng(3))
        sizes = np.log(np.sqrt(np.mean(drawn**2, axis=0)))
        assert drawn.shape == (COUNT, 4000)
        assert np.std(sizes) == pytest.approx(np.hypot(spread, np.sqrt(0.5 / COUNT)), rel=0.05)
        assert np.mean(sizes) == pytest.approx(0.0, abs=0.05)


def found(*names: str) -> Any:
    """A diagnosis of one fabric in which the last of some effects explains most; no block shows anything of it."""
    evidence = {n: Evidence(n, 0.0, float(k), {}, {}, {}, 0.0, {}) for k, n in enumerate(("none", *names, "unknown"))}
    own = showing(block(0), np.random.default_rng(1).standard_normal(COUNT))
    rows = {n: (k + 1.0) * np.ones((2, COUNT)) for k, n in enumerate(("crease", "off_grain"))}
    own = replace(own, stated=replace(own.stated, responses=rows))
    pixels = PixelBlock(np.zeros(2), {name: np.zeros((2, 2)) for name in rows}, sensor_known=True)
    return SimpleNamespace(blocks=[own], cause=SimpleNamespace(evidence=evidence), pixels=pixels)


def test_the_most_flexible_effect_is_always_the_same_one() -> None:
    assert baseline_answers(found("bending_hysteresis", "crease"))["names"]["most_flexible"] == "bending_hysteresis"
    assert baseline_answers(found("off_grain", "crease"))["names"]["most_flexible"] == "crease"


def test_shared_numbers_are_seen_by_the_baselines_too() -> None:
    """What changes pixels alone has no shape."""
    diagnosis = found("crease")
    (own,) = diagnosis.blocks
    rows = {**own.stated.responses, "dropout": np.zeros((2, COUNT))}
    diagnosis.blocks = [replace(own, stated=replace(own.stated, responses=rows))]
    shown = {name: np.zeros((2, 2)) for name in rows} | {"dropout": np.array([[5.0, 0.0], [40.0, 0.0]])}
    diagnosis.pixels = PixelBlock(np.array([41.0, 0.3]), shown, sensor_known=True)
    names = baseline_answers(diagnosis)["names"]
    assert (names["nearest_template"], names["least_residual"]) == ("dropout", "dropout")


def test_the_page_says_what_the_baselines_do() -> None:
    answers = [answer("named", [DRAFT], "air_draft", 0.9), answer("none", [], "none", 0.9)]
    plan = {"cases": 2, "seed": 1, "scenes": ["stretch"], "fabrics": 4, "repeats": 2, "pool": 4, "resolution_m": 0.0125}
    page = render_page({**plan, "withhold": []}, answers, score(answers))
    assert "Most flexible: always `bending_hysteresis`" in page
    assert "it alarms at p < 0.05 in 0 of 1 named cases and 0 of 1 none cases." in page


def test_stretch_alone_is_judged_where_there_is_any() -> None:
    diagnosis = found("crease")
    shown = showing(block(1, "hanging"), np.full(COUNT, 500.0))
    shown = replace(shown, stated=replace(shown.stated, responses=diagnosis.blocks[0].stated.responses))
    both = SimpleNamespace(blocks=[diagnosis.blocks[0], shown], cause=diagnosis.cause, pixels=diagnosis.pixels)
    assert baseline_answers(both) == baseline_answers(diagnosis)
    assert baseline_answers(diagnosis)["mmd_p"] == mmd_p(diagnosis.blocks)


def test_examples_of_effects_tried_otherwise_are_no_use(tmp_path: Path) -> None:
    effects = ("air_draft", "crease")
    rows = {name: np.zeros((len(node_weights(get_effect(name), get_effect(name).typical())), 3)) for name in effects}
    folder = tmp_path / EXAMPLES_FOLDER
    folder.mkdir()
    np.savez(folder / "case-001.npz", **rows)
    assert len(examples_of(tmp_path, effects)) == 1
    np.savez(folder / "case-002.npz", **rows | {"crease": rows["crease"][:-1]})  # fewer places
    with pytest.raises(InputError, match="another version") as caught:
        examples_of(tmp_path, effects)
    assert caught.value.code == "blind_train"
