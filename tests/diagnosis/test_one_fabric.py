"""What one fabric alone says decides nothing."""

from __future__ import annotations

import pytest

from diagnosis.inference.evidence import Evidence
from diagnosis.inference.likelihood import ALONE_NATS
from diagnosis.inference.one_fabric import LOST_ALONE_NATS, by_more_than_one


def found(name: str, gains: tuple[float, ...]) -> Evidence:
    by_fabric = {f"f{n}": gain for n, gain in enumerate(gains)}
    return Evidence(name, sum(gains), sum(gains), by_fabric, {}, {}, 0.0, {})


@pytest.mark.parametrize(
    ("name", "gains", "counted"),
    [
        ("crease", (1.0, 2.0, 1.5), 4.5),
        ("crease", (9.0, 1.0, 0.0), 1.0 + 1.0 + ALONE_NATS),  # no more than the next, and a little
        ("crease", (9.0, -1.0), -1.0 + ALONE_NATS),
        ("crease", (5.0, 6.0, -0.5, -9.0), 10.5 - 0.5 - LOST_ALONE_NATS),  # no less than the next but one, and a little
        ("crease", (5.0, 6.0, -9.0, -9.0), -7.0),  # two fabrics say so
        ("crease", (5.0, -9.0), 2.0 - 9.0),  # of two fabrics one may be right
        ("camera_rotation", (5.0, 6.0, -0.5, -9.0), 1.5),  # it moves no folds
        ("unknown", (5.0, 6.0, -0.5, -9.0), 1.5),
    ],
)
def test_one_fabric_says_little_more_than_the_next(name: str, gains: tuple[float, ...], counted: float) -> None:
    nothing = found("none", (0.0,) * len(gains))
    assert by_more_than_one(found(name, gains), nothing).log_evidence == pytest.approx(counted)
    assert by_more_than_one(found(name, gains), nothing).best == pytest.approx(counted)
