"""A real PostgreSQL of the test's own: a fresh cluster in a folder, reached by a socket there."""

from __future__ import annotations

import os
import pwd
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

DEBIAN = Path("/usr/lib/postgresql")


def server_programs() -> Path | None:
    """Folder of `initdb` and `pg_ctl`; Debian keeps them off the path."""
    found = shutil.which("initdb")
    if found is not None:
        return Path(found).resolve().parent
    versions = sorted(DEBIAN.glob("*/bin/initdb"), key=lambda path: int(path.parts[-3]))
    return versions[-1].parent if versions else None


@contextmanager
def postgres() -> Iterator[str]:
    """URL of an empty database, for the length of the block; skips where PostgreSQL is not installed."""
    programs = server_programs()
    if programs is None:
        pytest.skip("PostgreSQL's server programs are not installed: apt-get install postgresql")
    user = _server_user()
    # Short: a socket's path has at most 107 characters.
    folder = Path(tempfile.mkdtemp(prefix="dm-pg-"))
    if user is not None:
        shutil.chown(folder, user)
    control = [str(programs / "pg_ctl"), "--pgdata", str(folder / "data"), "--wait"]
    options = f"-k {folder} -c listen_addresses='' -c fsync=off -c max_connections=60"
    try:
        initdb = [str(programs / "initdb"), "--pgdata", str(folder / "data"), "--username", "tester", "--auth", "trust"]
        _run([*initdb, "--encoding", "UTF8", "--no-sync"], user)
        _run([*control, "--log", str(folder / "log"), "--options", options, "start"], user)
        yield f"postgresql://tester@/postgres?host={folder}"
    finally:
        if (folder / "data" / "postmaster.pid").exists():
            _run([*control, "--mode", "immediate", "stop"], user)
        shutil.rmtree(folder, ignore_errors=True)


def _server_user() -> str | None:
    """PostgreSQL refuses to run as root: somebody else's name then."""
    if os.getuid() != 0:
        return None
    for name in ("postgres", "nobody"):
        try:
            return pwd.getpwnam(name).pw_name
        except KeyError:
            continue
    pytest.skip("PostgreSQL does not run as root, and there is no user 'postgres' or 'nobody'")


def _run(command: list[str], user: str | None) -> None:
    done = subprocess.run(command, user=user, capture_output=True, text=True, timeout=90, cwd="/", check=False)
    assert done.returncode == 0, done.stdout + done.stderr
