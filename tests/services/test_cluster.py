"""A Ray cluster that is not there, cannot be begun or goes away, told as what it is."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import ray

from services.dataset import cluster
from simcore.errors import InputError, MissingResourceError


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


@pytest.fixture
def head(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """A cluster of four CPUs that answers at any address; what is done with it."""
    done: list[str] = []
    monkeypatch.setattr(cluster, "_knock", lambda address: None)
    monkeypatch.setattr("ray.init", lambda **given: done.append("joined"))
    monkeypatch.setattr("ray.shutdown", lambda: done.append("left"))
    monkeypatch.setattr("ray.cluster_resources", lambda: {"CPU": 4.0})
    return done


def test_sigterm_does_afterwards_what_it_did(head: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Ray takes it for itself, and aborts the process of it."""
    monkeypatch.setattr("ray.init", lambda **_: signal.signal(signal.SIGTERM, lambda *_: None))
    former = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        for address in ("local", "head:6379"):
            with cluster.ray_cluster(address, 1):
                assert signal.getsignal(signal.SIGTERM) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGTERM, former)


@pytest.mark.parametrize("name", ["of-a-batch-job/" * 8, "höhe"])
def test_a_folder_in_which_ray_makes_no_sockets_is_told(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / name
    folder.mkdir(parents=True)
    monkeypatch.setenv("RAY_TMPDIR", str(folder))
    with (
        pytest.raises(InputError, match="set RAY_TMPDIR to a folder with a short name") as caught,
        cluster.ray_cluster("local", 1),
    ):
        raise AssertionError("the work began")
    assert caught.value.code == "ray_folder" and str(folder) in str(caught.value)


def test_a_cluster_without_a_gpu_is_told(head: list[str]) -> None:
    with (
        pytest.raises(InputError, match="no GPU here for --solver cuda: use single or batch") as caught,
        cluster.ray_cluster("head:6379", None, gpus=True),
    ):
        raise AssertionError("the work began")
    assert caught.value.code == "gpu_missing"
    assert head == ["joined", "left"]


def test_a_cluster_that_wants_its_token_is_told(head: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(**_: object) -> None:
        raise ray.exceptions.AuthenticationError("Token authentication is enabled but no token was found")

    monkeypatch.setattr("ray.init", refuse)
    with (
        pytest.raises(InputError, match="head:6379 wants its token: set RAY_AUTH_MODE=token and") as caught,
        cluster.ray_cluster("head:6379", None),
    ):
        raise AssertionError("the work began")
    assert caught.value.code == "cluster_token"


def test_an_address_from_the_environment_is_said_to_be(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing listens at port 9."""
    for variable, option, told in (
        ("127.0.0.1:9", None, r"at 127\.0\.0\.1:9 \(RAY_ADDRESS\) \(.*\); start one, or unset RAY_ADDRESS$"),
        (None, "head:99999", r"at head:99999 \(Port out of range 0-65535\); start one, or leave --address out$"),
        (
            None,
            "a..b:6379",
            r"at a\.\.b:6379 \(a\.\.b cannot be a machine's name\); start one, or leave --address out$",
        ),
        ("head:6379", "127.0.0.1:9", r"at 127\.0\.0\.1:9 \(.*\); start one, or leave --address out$"),
    ):
        monkeypatch.setenv("RAY_ADDRESS", variable or "")
        with pytest.raises(InputError, match=told) as caught, cluster.ray_cluster(option, None):
            raise AssertionError("the work began")
        assert caught.value.code == "cluster_missing"


@pytest.mark.parametrize(
    ("path", "quoted"),
    [
        ("/srv/drapemeter/.venv/bin/python", None),
        ("/home/anna/Fabric tests/.venv/bin/python", "'/home/anna/Fabric tests/.venv/bin/python'"),
        ("/home/anna/tests(2)/.venv/bin/python", "'/home/anna/tests(2)/.venv/bin/python'"),
    ],
)
def test_an_interpreters_path_is_quoted_for_rays_shell(
    path: str, quoted: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: dict[str, Any] = {}
    monkeypatch.setattr("ray.init", lambda **named: given.update(named))
    monkeypatch.setattr("ray.shutdown", lambda: None)
    monkeypatch.setattr(sys, "executable", path)
    with cluster.ray_cluster("local", 1):
        assert given["runtime_env"] == (quoted and {"py_executable": quoted})


@pytest.mark.parametrize("folder", ["anna's", "anna\\tests"])
def test_an_interpreter_that_ray_cannot_start_is_told(folder: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ray.init", lambda **_: None)
    monkeypatch.setattr(sys, "executable", f"/home/{folder}/.venv/bin/python")
    with (
        pytest.raises(InputError, match="set the environment up in a folder without quotation marks") as caught,
        cluster.ray_cluster("local", 1),
    ):
        raise AssertionError("the work began")
    assert caught.value.code == "ray_interpreter" and folder in str(caught.value)


@pytest.mark.slow
@pytest.mark.ray
def test_work_is_done_by_an_interpreter_in_a_folder_with_a_blank(repository: Path, tmp_path: Path) -> None:
    environment = tmp_path / "fabric tests & more"
    environment.symlink_to(sys.prefix)
    program = """
from services.dataset.cluster import ray_cluster
from services.dataset.spread import spread
with ray_cluster("local", 1) as cores:
    print(*spread(abs, [-3], cores))
"""
    said = subprocess.run(
        [environment / "bin" / Path(sys.executable).name, "-c", program],
        env={**os.environ, "PYTHONPATH": str(repository)},
        capture_output=True,
        text=True,
        check=True,
        timeout=150,
    )
    assert said.stdout == "3\n", said.stderr
