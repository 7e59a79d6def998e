"""Stores on an S3 server process, with faults injected between."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from renderer.store import Store, StoreWriter, store_exists
from renderer.store_location import listed_sizes
from services.dataset.inspection import inspect_store
from services.dataset.sweep import prepare_store
from services.dataset.validation import validate_store
from simcore.errors import InputError, StoreError
from tests.services.dataset_helpers import COMMAND, SHARDS, small_sweep, write_without_ray
from tests.services.fault_proxy import FaultProxy, fault_proxy
from tests.services.s3_server import BUCKET, S3Server, s3_server

CONFIGURATION, FABRICS = small_sweep()


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[S3Server]:
    """One server for all tests here; each uses a prefix of its own."""
    with s3_server(tmp_path_factory.mktemp("s3")) as running:
        yield running


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small sweep's store in a local folder."""
    return write_without_ray(tmp_path_factory.mktemp("undisturbed") / "store.zarr", CONFIGURATION, FABRICS)


def use(monkeypatch: pytest.MonkeyPatch, settings: dict[str, str]) -> None:
    """Reach the server as a user would tell it."""
    for name, value in settings.items():
        monkeypatch.setenv(name, value)


def write_shards(url: str, source: Path, shards: list[int]) -> None:
    """What a worker would write, its rows taken from a finished store."""
    writer, finished = StoreWriter.open(url), Store.open(source)
    for shard in shards:
        writer.write_shard(shard, finished.read_shard(shard))


def assert_same_as_folder(url: str, folder: Path) -> None:
    """Every stored object equal, bit for bit, and the store valid."""
    remote, local = Store.open(url), Store.open(folder)
    assert remote.checksums.tobytes() == local.checksums.tobytes()
    for shard in range(local.shards):
        assert remote.stored_bytes(shard) == local.stored_bytes(shard)
    assert validate_store(remote).valid


def test_ray_workers_write_to_s3_what_they_write_to_a_folder(
    server: S3Server, undisturbed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    use(monkeypatch, server.environment())
    url = f"s3://{BUCKET}/sweeps/ray.zarr"
    subprocess.run([*COMMAND, "--out", url, "--json"], check=True, capture_output=True, timeout=300)
    assert_same_as_folder(url, undisturbed)
    with pytest.raises(InputError, match="--resume"):
        prepare_store(url, CONFIGURATION, resume=False)


def test_broken_connections_and_busy_answers_lose_nothing(
    server: S3Server, undisturbed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = f"s3://{BUCKET}/faults.zarr"
    with fault_proxy(server.port, fault_share=0.3) as proxy:
        use(monkeypatch, server.environment(proxy.port))
        write_shards(url, undisturbed, prepare_store(url, CONFIGURATION, resume=False))
        assert_same_as_folder(url, undisturbed)
        assert proxy.faults > 10, "the proxy was to break something"


def test_a_lost_object_store_ends_the_sweep_and_a_resumed_one_is_the_same(
    server: S3Server, undisturbed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DRAPEMETER_STORE_RETRY_S", "1")
    url = f"s3://{BUCKET}/outage.zarr"
    with fault_proxy(server.port) as proxy:
        use(monkeypatch, server.environment(proxy.port))
        shards = prepare_store(url, CONFIGURATION, resume=False)
        write_shards(url, undisturbed, shards[:3])
        proxy.down = True
        with pytest.raises(StoreError) as raised:
            write_shards(url, undisturbed, shards[3:])
        assert raised.value.code == "store_unreachable"
        proxy.down = False
        remaining = prepare_store(url, CONFIGURATION, resume=True)
        assert remaining == list(range(3, SHARDS))
        write_shards(url, undisturbed, remaining)
        assert_same_as_folder(url, undisturbed)
        assert inspect_store(Store.open(url)).stored_bytes == inspect_store(Store.open(undisturbed)).stored_bytes


def marks(url: str) -> int:
    """Shards that are marked complete, by listing alone."""
    return sum(key.startswith("checksum/c/") for key, _ in listed_sizes(url))


def wait_for_marks(url: str, count: int, driver: subprocess.Popen[str]) -> None:
    """Until so many shards are marked complete, however busy the machine is; the test's own timeout ends it."""
    while marks(url) < count:
        assert driver.poll() is None, "the sweep ended by itself"
        time.sleep(0.05)


@contextmanager
def outage(server: S3Server, proxy: FaultProxy) -> Iterator[None]:
    """The server is killed and started again on its port and data; one that forgets them is cut off instead."""
    if server.keeps_data:
        server.kill()
        yield
        server.start()
    else:
        proxy.down = True
        yield
        proxy.down = False


@pytest.mark.ray
@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_sweep_rides_out_a_short_outage_and_is_resumed_after_a_long_one(
    server: S3Server, undisturbed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = f"s3://{BUCKET}/outages.zarr"
    with fault_proxy(server.port) as proxy:
        use(monkeypatch, server.environment(None if server.keeps_data else proxy.port))
        prepare_store(url, CONFIGURATION, resume=False)
        command = [*COMMAND, "--workers", "1", "--out", url, "--resume", "--json"]
        # a server that is started again on a busy machine needs several of these seconds
        impatient = os.environ | {"DRAPEMETER_STORE_RETRY_S": "15"}
        driver = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=impatient)
        try:
            wait_for_marks(url, 1, driver)
            with outage(server, proxy):
                time.sleep(3.0)
            ridden_out = marks(url)
            assert ridden_out < SHARDS, "the server was to be killed in mid-run"
            wait_for_marks(url, ridden_out + 1, driver)
            with outage(server, proxy):
                _, said = driver.communicate(timeout=60)
        finally:
            driver.kill()
            driver.wait()
        assert driver.returncode == 1
        assert [line for line in said.splitlines() if "[store_unreachable]" in line] == said.splitlines()[-1:]
        assert "Traceback" not in said and "--resume" in said
        assert ridden_out < marks(url) < SHARDS
        subprocess.run(command, check=True, capture_output=True, timeout=200)
        assert_same_as_folder(url, undisturbed)


def test_wrong_credentials_are_bad_input(server: S3Server, monkeypatch: pytest.MonkeyPatch) -> None:
    with fault_proxy(server.port) as proxy:
        proxy.forbidding = not server.checks_credentials  # the stand-in lets everybody in
        use(monkeypatch, server.environment(proxy.port) | {"AWS_SECRET_ACCESS_KEY": "wrong"})
        for attempt in (Store.open, store_exists):
            with pytest.raises(InputError) as raised:
                attempt(f"s3://{BUCKET}/x.zarr")
            assert raised.value.code == "store_credentials"


def test_a_missing_bucket_is_bad_input(server: S3Server, monkeypatch: pytest.MonkeyPatch) -> None:
    use(monkeypatch, server.environment())
    with pytest.raises(InputError) as raised:
        prepare_store("s3://no-such-bucket/x.zarr", CONFIGURATION, resume=False)
    assert raised.value.code == "store_missing"
