"""What `/openapi.json` documents is what the server does: generated requests, examples and corner cases."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.services.served import drapemeter, serving

CHECKS_NOT_MADE = "positive_data_acceptance"
"""A schema cannot say that a picture must show cloth, or that a key must be new: 422 is documented for those."""


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_documented_is_actual(tmp_path: Path) -> None:
    key = json.loads(drapemeter(tmp_path, "keys", "create", "--name", "contract", "--json").stdout)["token"]
    settings = {"DRAPEMETER_ENVIRONMENT": "production", "DRAPEMETER_MODEL": str(tmp_path / "none")}
    with serving(tmp_path, "--workers", "0", **settings) as running:
        command = [
            *(sys.executable, "-m", "schemathesis.cli", "run", f"{running.url}/openapi.json"),
            *("--header", f"Authorization: Bearer {key}", "--checks", "all", "--exclude-checks", CHECKS_NOT_MADE),
            *("--phases", "examples,coverage,fuzzing", "--max-examples", "3", "--seed", "7", "--request-timeout", "60"),
            *("--generation-database", "none", "--suppress-health-check", "all"),
        ]
        done = subprocess.run(command, capture_output=True, text=True, timeout=380, check=False, cwd=tmp_path)
    assert done.returncode == 0, done.stdout[-6000:] + done.stderr[-2000:]
    assert "16 selected" in done.stdout
