"""A Ray cluster that goes away, told as what it is."""

from __future__ import annotations

import pytest

from services.dataset import cluster
from simcore.errors import MissingResourceError


def test_a_cluster_that_goes_away_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "_connect", lambda address: None)
    monkeypatch.setattr(cluster, "cluster_cpus", lambda: 4.0)
    monkeypatch.setattr("ray.shutdown", lambda: None)
    with (
        pytest.raises(MissingResourceError, match="ray://head:10001 went away") as caught,
        cluster.ray_cluster("ray://head:10001", None) as cores,
    ):
        assert cores == 4
        raise ConnectionError("Failed during this or a previous request.")
    assert caught.value.code == "cluster_lost"
