"""Fixtures of the service's tests."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import httpx
import pytest

from services.cli.ending import Ending
from services.db.engine import Database
from services.db.migrate import upgrade
from tests.services.served import Served, serving

MOST_BYTES = 2 * 1024 * 1024
"""Longest request that the tests' server takes."""


ENDING = Ending.prepared()
"""The tests end as a command does where Ray was used: once in some fifty runs the process crashed at its very end."""


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    """What the tests came to is what the process ends with."""
    ENDING.status = int(session.exitstatus)


@pytest.fixture(scope="session")
def tiny_model_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model folder: the real network, made small and trained for a moment on analytic cloth."""
    from tests.trainer.conftest import TINY, AnalyticSource
    from trainer.train import train

    folder = tmp_path_factory.mktemp("model") / "estimator"
    train(AnalyticSource(materials=20), replace(TINY, epochs=1)).save(folder)
    return folder


@pytest.fixture(scope="session")
def served(tmp_path_factory: pytest.TempPathFactory, tiny_model_folder: Path) -> Iterator[Served]:
    """A server without API keys, open to this machine, with a model and one worker."""
    limits = {"DRAPEMETER_MAX_REQUEST_BYTES": str(MOST_BYTES), "DRAPEMETER_MAX_UNPACKED_BYTES": str(2 * MOST_BYTES)}
    with serving(tmp_path_factory.mktemp("served"), "--model", str(tiny_model_folder), **limits) as running:
        yield running


@pytest.fixture(scope="session")
def client(served: Served) -> Iterator[httpx.Client]:
    """A client of that server."""
    with served.client() as opened:
        yield opened


@pytest.fixture
def database(tmp_path: Path) -> Iterator[Database]:
    """An empty SQLite database with its tables."""
    opened = Database(f"sqlite:///{tmp_path}/test.db")
    upgrade(opened)
    yield opened
    opened.close()


@pytest.fixture(scope="session")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store of analytic cloth."""
    from tests.services.analytic_store import make_store

    return make_store(tmp_path_factory.mktemp("store") / "s.zarr")


@pytest.fixture(scope="session")
def model(store: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model that `drapemeter train` made of it."""
    from services.cli import main
    from tests.services.analytic_store import QUICK

    folder = tmp_path_factory.mktemp("trained") / "model"
    assert main.run(["train", "--store", str(store), "--out", str(folder), *QUICK]) == 0
    return folder
