"""`POST /v1/datasets`: a sweep as a job, alone and on a Ray cluster."""

from __future__ import annotations

from pathlib import Path

import pytest

from renderer.store import Store
from tests.services.served import finished, serving

SMALL = {"materials": 2, "jitters": 1, "inclinations": 1, "resolution_m": 0.05, "seed": 3}


@pytest.mark.slow
@pytest.mark.timeout(400)
@pytest.mark.ray
def test_a_dataset_job_leaves_a_complete_store_where_the_server_keeps_them(tmp_path: Path) -> None:
    with serving(tmp_path) as running, running.client() as client:
        answer = client.post("/v1/datasets", json=SMALL)
        assert answer.status_code == 202
        job = finished(client, answer.headers["location"])
    assert job["problem"] is None
    assert job["result"]["samples"] == 4
    store = Store.open(job["result"]["store"])
    assert (len(store), bool(store.complete.all())) == (4, True)
    assert Path(job["result"]["store"]).parent == tmp_path / "datasets"
