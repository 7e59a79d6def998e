"""Write requirements.txt and requirements-dev.txt from what is installed beside this interpreter.

The run-time file holds everything that the distribution's dependencies reach; the other one adds the tools of the
`dev` extra. Versions are plain (no local label such as +cpu), so that any index can serve them. Usage: make lock
"""

from __future__ import annotations

import sys
import tomllib
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parent.parent
HEADER = "# Exact versions that are tested together; made by `make lock`, ranges stand in pyproject.toml.\n"


def closure(requirements: list[str]) -> dict[str, str]:
    """Name to pin of everything that ``requirements`` reach in this environment."""
    pins: dict[str, str] = {}
    seen: set[tuple[str, frozenset[str]]] = set()
    todo = [Requirement(text) for text in requirements]
    while todo:
        requirement = todo.pop()
        name = canonicalize_name(requirement.name)
        key = (name, frozenset(requirement.extras))
        if key in seen or is_accelerator(name):
            continue
        seen.add(key)
        try:
            found = distribution(name)
        except PackageNotFoundError:
            sys.exit(f"error: {requirement} is not installed here; install it first, then lock")
        if not requirement.specifier.contains(found.version.split("+")[0], prereleases=True):
            sys.exit(f"error: {name} {found.version} is installed, but {requirement} is asked for")
        pins[name] = f"{found.metadata['Name']}=={found.version.split('+')[0]}"
        for text in found.requires or []:
            needed = Requirement(text)
            environments = [{"extra": extra} for extra in (*requirement.extras, "")]
            if needed.marker is None or any(needed.marker.evaluate(environment) for environment in environments):
                todo.append(needed)
    return pins


def is_accelerator(name: str) -> bool:
    """Parts of a CUDA build of PyTorch: pinned by PyTorch itself, absent from a CPU build."""
    return name.startswith(("nvidia-", "cuda-")) or name == "triton"


def write(path: Path, pins: dict[str, str], first_line: str = "") -> None:
    """Write one requirements file, sorted by name."""
    lines = [pins[name] for name in sorted(pins)]
    path.write_text(HEADER + first_line + "\n".join(lines) + "\n", encoding="utf-8")
    print(f"{path.name}: {len(lines)} pins")


def main() -> None:
    """Lock the run-time set, then what the tools add."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    run_time = closure(project["dependencies"])
    tools = closure(project["dependencies"] + project["optional-dependencies"]["dev"])
    write(ROOT / "requirements.txt", run_time)
    added = {name: pin for name, pin in tools.items() if name not in run_time}
    write(ROOT / "requirements-dev.txt", added, "-r requirements.txt\n")


if __name__ == "__main__":
    main()
