"""Settings of the service: environment variables ``DRAPEMETER_*``, which options of ``drapemeter serve`` override."""

from __future__ import annotations

import ipaddress
import os
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from pydantic import Field
from pydantic_settings import BaseSettings, SettingsConfigDict

from simcore.errors import InputError

if TYPE_CHECKING:
    from sqlalchemy.engine import URL

MIB = 1024 * 1024
DAY_S = 86400.0
CENTURY_DAYS = 36525.0
"""No date that a database holds is asked for from farther back."""
WEAK_PASSWORDS = frozenset({"", "changeme", "drapemeter", "example", "password", "postgres", "secret", "test"})


class Settings(BaseSettings):
    """What the server and its workers need to know; see ``docs/api.md``."""

    model_config = SettingsConfigDict(env_prefix="DRAPEMETER_", env_ignore_empty=True, extra="ignore", frozen=True)

    environment: Literal["development", "production"] = "development"
    host: str = "127.0.0.1"
    port: int = Field(default=8000, ge=0, le=65535)
    database: str = "sqlite:///drapemeter.db"
    model: Path | None = Field(default=None, description="Folder of the trained estimator.")
    dataset_root: str = Field(default="datasets", description="Folder or s3:// URL under which dataset jobs write.")
    log_level: Literal["debug", "info", "warning", "error"] = "info"

    max_request_bytes: int = Field(default=64 * MIB, ge=1024)
    max_unpacked_bytes: int = Field(default=512 * MIB, ge=1024)
    max_picture_pixels: int = Field(default=4096 * 4096, ge=64 * 64)

    estimate_timeout_s: float = Field(default=60.0, gt=0, le=DAY_S)
    estimate_queue: int = Field(default=8, ge=1, description="Estimates that may wait; more are refused with 503.")

    workers: int = Field(default=1, ge=0, le=64, description="Job worker processes started by the server.")
    ray_address: str | None = Field(default=None, description="Ray cluster that runs the jobs; none: this machine.")
    job_queue: int = Field(default=1000, ge=1, description="Jobs that may wait; more are refused with 429.")
    job_lease_s: float = Field(
        default=20.0, gt=0.2, le=DAY_S, description="A worker silent for so long has lost its job."
    )
    job_attempts: int = Field(default=3, ge=1)
    job_time_limit_s: float = Field(
        default=DAY_S, gt=0, le=366 * DAY_S, description="A job that takes longer is stopped and fails."
    )
    job_shutdown_grace_s: float = Field(default=5.0, ge=0, le=DAY_S)
    job_cluster_patience_s: float = Field(
        default=600.0,
        ge=0,
        le=366 * DAY_S,
        description="How long a job waits for a Ray cluster that is away, or for room on a disk.",
    )
    job_retention_days: float = Field(default=30.0, gt=0, le=CENTURY_DAYS)
    idempotency_hours: float = Field(default=24.0, gt=0, le=24 * CENTURY_DAYS)

    @property
    def on_loopback(self) -> bool:
        """Only programs on this machine can reach the server."""
        if self.host == "localhost":
            return True
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return False

    @property
    def guarded(self) -> bool:
        """API keys are needed whether or not one exists yet."""
        return not self.on_loopback or self.environment == "production"

    def require_safe(self) -> None:
        """Check before serving others.

        Raises:
            InputError: the database's password is empty or a well-known one while the server is open to others.
        """
        from services.db.engine import parse_url

        url = parse_url(self.database)
        if not self.guarded or url.get_backend_name() == "sqlite":
            return
        elsewhere = bool(url.host) or not str(url.query.get("host", "/")).startswith("/")
        if elsewhere and not _signs_in_otherwise(url) and _password(url).lower() in WEAK_PASSWORDS:
            raise InputError(
                "the database password is empty or a well-known default: set a random one before serving others",
                code="default_secret",
            )


def _password(url: URL) -> str:
    """Of a database server, as its library finds it: in the URL or the environment."""
    given = url.password if url.password is not None else url.query.get("password", os.environ.get("PGPASSWORD"))
    return str(given or "")


def _signs_in_otherwise(url: URL) -> bool:
    """By a certificate or a password file."""
    file = Path(os.environ.get("PGPASSFILE", "~/.pgpass")).expanduser()
    named = "sslcert" in url.query or "passfile" in url.query or "PGSSLCERT" in os.environ
    return not _password(url) and url.password is None and (named or file.is_file())
