"""The commands of `docs/api.md`, run as they stand."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.services.served import environment, serving

TOOLS = ("bash", "curl", "jq", "zip")


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_the_documented_commands_work(repository: Path, tmp_path: Path, tiny_model_folder: Path) -> None:
    missing = [tool for tool in TOOLS if shutil.which(tool) is None]
    if missing:
        pytest.skip(f"not installed: {', '.join(missing)}")
    text = (repository / "docs" / "api.md").read_text(encoding="utf-8")
    script = "\n".join(re.findall(r"```sh\n(.*?)```", text, flags=re.DOTALL))
    with serving(tmp_path, "--model", str(tiny_model_folder)) as running:
        commands = "set -euo pipefail\n" + script.replace("http://127.0.0.1:8000", running.url)
        env = environment(tmp_path)
        env["PATH"] = f"{Path(sys.executable).parent}:{env['PATH']}"
        done = subprocess.run(
            ["bash", "-c", commands], cwd=tmp_path, env=env, capture_output=True, text=True, timeout=380, check=False
        )
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
    assert '"out_of_distribution"' in done.stdout
    assert '"standard_error"' in done.stdout
