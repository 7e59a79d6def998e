"""Settings of the service: what cannot be is one line at the start, not workers that die one after another."""

from __future__ import annotations

from pathlib import Path

import pytest
from sqlalchemy import text
from sqlalchemy.exc import OperationalError

from services.cli.serve import load_settings
from services.db.engine import Database, is_full, parse_url
from services.settings import Settings
from simcore.errors import InputError


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("JOB_RETENTION_DAYS", "999999"),
        ("JOB_RETENTION_DAYS", "inf"),
        ("IDEMPOTENCY_HOURS", "1e9"),
        ("JOB_LEASE_S", "inf"),
        ("JOB_TIME_LIMIT_S", "1e12"),
        ("JOB_SHUTDOWN_GRACE_S", "inf"),
        ("ESTIMATE_TIMEOUT_S", "nan"),
        ("JOB_LEASE_S", "0"),
    ],
)
def test_times_that_no_clock_has_are_refused(name: str, value: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(f"DRAPEMETER_{name}", value)
    with pytest.raises(InputError, match=f"DRAPEMETER_{name}") as caught:
        load_settings({})
    assert caught.value.code == "setting_invalid"


def test_long_times_that_a_clock_has_are_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("JOB_RETENTION_DAYS", "36500"), ("IDEMPOTENCY_HOURS", "8760"), ("JOB_LEASE_S", "3600")):
        monkeypatch.setenv(f"DRAPEMETER_{name}", value)
    found = load_settings({})
    assert (found.job_retention_days, found.idempotency_hours, found.job_lease_s) == (36500.0, 8760.0, 3600.0)


def test_an_empty_variable_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("MODEL", "RAY_ADDRESS", "HOST", "PORT"):
        monkeypatch.setenv(f"DRAPEMETER_{name}", "")
    assert load_settings({}) == Settings()


def test_a_databases_password_may_come_otherwise(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PGPASSFILE", str(tmp_path / "none"))
    by_name, by_query = "postgresql://u@db/d", "postgresql:///d?host=10.0.0.5&user=u"
    for url in (by_name, by_query):
        with pytest.raises(InputError, match="password is empty") as caught:
            Settings(host="0.0.0.0", database=url).require_safe()
        assert caught.value.code == "default_secret"
    Settings(host="0.0.0.0", database=f"{by_query}&password=sFwq29xVbn").require_safe()
    Settings(host="0.0.0.0", database="postgresql:///d?host=/run/postgresql").require_safe()
    monkeypatch.setenv("PGPASSWORD", "sFwq29xVbn")
    Settings(host="0.0.0.0", database=by_name).require_safe()
    monkeypatch.setenv("PGPASSWORD", "")
    (tmp_path / "pgpass").touch()
    monkeypatch.setenv("PGPASSFILE", str(tmp_path / "pgpass"))
    Settings(host="0.0.0.0", database=by_name).require_safe()


def test_a_databases_password_is_not_shown() -> None:
    for url in (
        "postgresql://u:sFwq29xVbn@h/d",
        "postgresql://h/d?user=u&password=sFwq29xVbn",
        "postgresql://h/d?sslpassword=sFwq29",
    ):
        assert "sFwq" not in Database(url).public_url
    with pytest.raises(InputError, match="%40") as caught:
        parse_url("postgresql://u:sFwq@29xVbn@h/d")
    assert "29xVbn" not in str(caught.value)


def test_a_full_disk_is_told_from_a_database_that_is_away(tmp_path: Path) -> None:
    database = Database(f"sqlite:///{tmp_path / 'd.db'}")
    with pytest.raises(OperationalError) as caught, database.write() as session:
        session.execute(text("PRAGMA max_page_count = 3"))
        session.execute(text("CREATE TABLE t (x BLOB)"))
        session.execute(text("INSERT INTO t VALUES (zeroblob(100000))"))
    assert is_full(caught.value) and not is_full(OperationalError("", None, Exception("locked")))
    database.close()
