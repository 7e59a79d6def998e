"""`POST /v1/datasets`: a sweep as a job, alone and on a Ray cluster."""

from __future__ import annotations

from pathlib import Path

import pytest

from renderer.sensor import SENSORS
from renderer.store import Store
from services.dataset.configuration import IDEAL
from services.jobs.kinds.dataset import DatasetInputs
from tests.services.served import finished, serving

SMALL = {"materials": 2, "jitters": 1, "inclinations": 1, "resolution_m": 0.05, "seed": 3, "sensor": "sr300"}


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
    assert store.attributes["configuration"]["sensor"] == "sr300"
    assert Path(job["result"]["store"]).parent == tmp_path / "datasets"


def test_a_job_takes_every_sensor_that_the_command_takes() -> None:
    assert DatasetInputs(materials=1).plan()[0].sensor == IDEAL
    offered = DatasetInputs.model_json_schema()["properties"]["sensor"]["enum"]
    assert sorted(offered) == sorted(SENSORS)
    for name in offered:
        assert DatasetInputs.model_validate({"materials": 1, "sensor": name}).plan()[0].sensor == name
