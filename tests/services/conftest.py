"""Fixtures of the service's tests."""

from __future__ import annotations

import atexit
import os
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import httpx
import pytest

from services.db.engine import Database
from services.db.migrate import upgrade
from tests.services.served import Served, serving

MOST_BYTES = 2 * 1024 * 1024
"""Longest request that the tests' server takes."""


_SESSIONS: list[pytest.Session] = []


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Keep what the tests came to, for `_leave`."""
    _SESSIONS.append(session)


def _leave() -> None:
    """After Ray, leave without taking the interpreter down.

    Native threads of Ray outlive ``ray.shutdown``; once in some fifty runs the process crashed at its very end, after
    all tests had passed. What Python does at exit (threads joined, later handlers run) is done by then.
    """
    if "ray" not in sys.modules or not _SESSIONS or hasattr(sys, "last_type"):
        return  # an error after the tests: Python's own status tells of it
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(int(_SESSIONS[-1].exitstatus))


atexit.register(_leave)  # before what the tests import registers: handlers run in reverse


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
