"""Settings of the service: what cannot be is one line at the start, not workers that die one after another."""

from __future__ import annotations

import pytest

from services.cli.serve import load_settings
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
