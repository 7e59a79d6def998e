"""The repository itself: pins, declared imports, recipes, compose file, links and size."""

from __future__ import annotations

import ast
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from importlib.metadata import packages_distributions
from pathlib import Path
from typing import Any

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

PACKAGES = ("simcore", "renderer", "capture", "metric", "trainer", "diagnosis", "services")
NOT_IMPORTED = {"mkl", "psycopg", "python-multipart"}
"""What other libraries load by name: a shared library, a driver, a reader of forms."""
OPTIONAL = {"pyrealsense2"}  # asked for by name where a camera is used


@pytest.fixture(scope="module")
def project(repository: Path) -> dict[str, Any]:
    return tomllib.loads((repository / "pyproject.toml").read_text(encoding="utf-8"))["project"]


@pytest.fixture(scope="module")
def compose(repository: Path) -> dict[str, Any]:
    document: dict[str, Any] = yaml.safe_load((repository / "docker-compose.yml").read_text(encoding="utf-8"))
    return document


def pins(path: Path) -> dict[str, Requirement]:
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if line and line[0] not in "#-"]
    return {canonicalize_name(Requirement(line).name): Requirement(line) for line in lines}


def tracked(repository: Path) -> list[Path]:
    if not (repository / ".git").exists():
        pytest.skip("not a git checkout")
    if shutil.which("git") is None:
        pytest.skip("no git here")
    # a clone that belongs to somebody else, as one that is mounted into a container
    trusted = {"GIT_CONFIG_COUNT": "1", "GIT_CONFIG_KEY_0": "safe.directory", "GIT_CONFIG_VALUE_0": "*"}
    listing = subprocess.run(
        ["git", "ls-files", "-z"],
        cwd=repository,
        env={**os.environ, **trusted},
        capture_output=True,
        text=True,
        check=True,
    )
    return [repository / name for name in listing.stdout.split("\0") if name]


def test_every_direct_dependency_is_pinned_within_its_range(repository: Path, project: dict[str, Any]) -> None:
    run_time = pins(repository / "requirements.txt")
    both = {**run_time, **pins(repository / "requirements-dev.txt")}
    for text in project["dependencies"]:
        assert_pinned(Requirement(text), run_time)
    for text in project["optional-dependencies"]["dev"]:
        assert_pinned(Requirement(text), both)


def assert_pinned(requirement: Requirement, found: dict[str, Requirement]) -> None:
    pin = found.get(canonicalize_name(requirement.name))
    assert pin is not None, f"{requirement} has no pin: run `make lock`"
    version = re.fullmatch(r"==([0-9][0-9a-z.]*)", str(pin.specifier))
    assert version, f"{pin} is not a plain pin"
    assert requirement.specifier.contains(version.group(1)), f"{pin} is outside {requirement}"


def imported_modules(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            yield node.module.split(".")[0]


def test_every_import_is_a_declared_dependency(repository: Path, project: dict[str, Any]) -> None:
    declared = {canonicalize_name(Requirement(text).name) for text in project["dependencies"]} | OPTIONAL
    distributions = packages_distributions()
    undeclared = {
        f"{path.relative_to(repository)}: {module}"
        for package in PACKAGES
        for path in (repository / package).rglob("*.py")
        for module in imported_modules(path)
        if module not in PACKAGES
        and module not in sys.stdlib_module_names
        and not declared & {canonicalize_name(name) for name in distributions.get(module, [module])}
    }
    assert not undeclared


def test_every_declared_dependency_is_imported(repository: Path, project: dict[str, Any]) -> None:
    distributions = packages_distributions()
    imported = {
        canonicalize_name(name)
        for package in PACKAGES
        for path in (repository / package).rglob("*.py")
        for module in imported_modules(path)
        for name in distributions.get(module, [])
    }
    declared = {canonicalize_name(Requirement(text).name) for text in project["dependencies"]}
    assert declared - imported == NOT_IMPORTED


def test_no_tracked_file_is_large_and_none_is_generated(repository: Path) -> None:
    for path in tracked(repository):
        shipped = path.is_relative_to(repository / "trainer" / "weights")  # trained weights: 25 MB in all
        assert shipped or path.stat().st_size < 1_000_000, f"{path.relative_to(repository)} is over 1 MB"
        assert "__pycache__" not in path.parts
        assert path.suffix not in {".pyc", ".db", ".whl"}
    weights = [path for path in tracked(repository) if path.is_relative_to(repository / "trainer" / "weights")]
    assert sum(path.stat().st_size for path in weights) < 25_000_000


def test_ci_runs_the_same_recipes_as_people(repository: Path) -> None:
    script = repository / ".ci" / "run"
    assert os.access(script, os.X_OK)
    text = script.read_text(encoding="utf-8")
    assert "set -euo pipefail" in text
    assert "make test" in text
    assert "make lint" in text
    makefile = (repository / "Makefile").read_text(encoding="utf-8")
    for recipe in ("setup", "demo", "test", "lint", "bench", "bench-solver", "serve", "clean"):
        assert re.search(rf"^{recipe}:", makefile, flags=re.MULTILINE), f"no recipe {recipe}"


@pytest.mark.parametrize("name", sorted(path.name for path in (Path(__file__).parents[1] / "scripts").glob("*.sh")))
def test_scripts_are_executable_and_parse(repository: Path, name: str) -> None:
    script = repository / "scripts" / name
    assert os.access(script, os.X_OK)
    subprocess.run(["bash", "-n", str(script)], check=True)


def test_find_python_refuses_an_unfit_interpreter_in_one_line(repository: Path) -> None:
    result = subprocess.run(
        [str(repository / "scripts" / "find-python.sh")],
        env={**os.environ, "PYTHON": "/bin/false"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 1
    assert result.stderr.count("\n") == 1
    assert "Python 3.11 or 3.12" in result.stderr


def test_compose_services_are_checked_for_health_or_run_once(compose: dict[str, Any]) -> None:
    services = compose["services"]
    assert {"api", "ray-head", "ray-worker", "postgres", "objects"} <= set(services)
    for name, service in services.items():
        assert "image" in service or "build" in service, name
        once = service.get("restart") == "no"
        assert once or "healthcheck" in service, f"{name} has no health check"
        for needed, how in service.get("depends_on", {}).items():
            condition = how["condition"]
            once_needed = services[needed].get("restart") == "no"
            assert condition == ("service_completed_successfully" if once_needed else "service_healthy"), name
    for mount in (mount for service in services.values() for mount in service.get("volumes", [])):
        assert mount.split(":")[0] in compose["volumes"], mount


def test_compose_builds_its_image_once(compose: dict[str, Any]) -> None:
    """Builds of one image side by side fail on a fresh machine; nobody else's image of the name is pulled."""
    own = {name: service for name, service in compose["services"].items() if service["image"].startswith("drapemeter:")}
    assert {"api", "migrate", "ray-head", "ray-worker"} <= set(own)
    assert [name for name, service in own.items() if "build" in service] == ["migrate"]
    assert all(service.get("pull_policy") == "never" for name, service in own.items() if name != "migrate")


def test_lines_of_the_example_environment_may_be_uncommented(repository: Path) -> None:
    """What stands behind a value in an environment file is part of it."""
    for line in (repository / "deploy" / "env.example").read_text(encoding="utf-8").splitlines():
        named = re.match(r"#? ?[A-Z_]+=(.*)", line)
        assert named is None or re.fullmatch(r"[\w.:-]*", named.group(1)), line


def test_recipes_take_no_folder_from_the_environment(repository: Path) -> None:
    """`make clean` removes them."""
    said = subprocess.run(
        ["make", "--dry-run", "clean"],
        cwd=repository,
        env={**os.environ, "OUT": "/srv/artifacts", "VENV": "/opt/venv"},
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert "/srv" not in said and "/opt" not in said and "demo-out" in said


def test_compose_pins_images_and_holds_no_secret(compose: dict[str, Any], repository: Path) -> None:
    example = (repository / "deploy" / "env.example").read_text(encoding="utf-8")
    for name, service in compose["services"].items():
        tag = service["image"].rsplit(":", 1)[-1].rstrip("}")
        assert re.search(r"\d", tag), f"{name}: image {service['image']} is not pinned"
        for key, value in service.get("environment", {}).items():
            if re.search(r"PASSWORD|SECRET|TOKEN|ACCESS_KEY", key):
                variable = re.fullmatch(r"\$\{([A-Z_]+):\?.*\}", str(value))
                assert variable, f"{name}: {key} must come from the environment and be required"
                assert f"{variable.group(1)}=" in example


def test_ray_nodes_stay_in_the_foreground_with_enough_shared_memory(compose: dict[str, Any]) -> None:
    for name in ("ray-head", "ray-worker"):
        service = compose["services"][name]
        assert "--block" in service["command"]
        assert "shm_size" in service
        assert service["environment"]["RAY_AUTH_MODE"] == "token"


def test_the_image_runs_without_root(repository: Path) -> None:
    lines = (repository / "Dockerfile").read_text(encoding="utf-8").splitlines()
    last_stage = lines[max(i for i, line in enumerate(lines) if line.startswith("FROM")) :]
    assert "USER 10001" in last_stage
    assert not [line for line in lines if line.startswith("COPY . ")]
    copied = {word for line in lines if line.startswith("COPY") for word in line.split()[1:-1]}
    assert set(PACKAGES) <= copied


def test_what_the_image_copies_is_sent_to_its_build(repository: Path) -> None:
    """`.dockerignore` lets nothing through but what it names."""
    let_through = {
        line[1:] for line in (repository / ".dockerignore").read_text(encoding="utf-8").splitlines() if line[:1] == "!"
    }
    lines = (repository / "Dockerfile").read_text(encoding="utf-8").splitlines()
    copies = [line.split()[1:-1] for line in lines if line.startswith("COPY ") and "--from=" not in line]
    copied = {word for words in copies for word in words}
    assert "requirements.txt" in copied and copied <= let_through


def links(text: str) -> Iterator[str]:
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if not re.match(r"[a-z]+:", target) and not target.startswith("#"):
            yield target.split("#")[0]


def test_links_in_the_documents_lead_somewhere(repository: Path) -> None:
    for path in (*repository.glob("*.md"), *(repository / "docs").rglob("*.md")):
        for target in links(path.read_text(encoding="utf-8")):
            assert (path.parent / target).exists(), f"{path.relative_to(repository)} links to {target}"


def test_licence_is_apache(repository: Path, project: dict[str, Any]) -> None:
    assert project["license"] == "Apache-2.0"
    assert "Apache License" in (repository / "LICENSE").read_text(encoding="utf-8")[:200]


def test_the_cluster_launcher_file_fits_rays_schema(repository: Path) -> None:
    import jsonschema
    import ray

    schema = json.loads((Path(ray.__file__).parent / "autoscaler" / "ray-schema.json").read_text(encoding="utf-8"))
    jsonschema.validate(yaml.safe_load((repository / "deploy" / "ray-cluster.yaml").read_text()), schema)


def test_the_kuberay_job_runs_our_ray_version_without_root(repository: Path) -> None:
    job = yaml.safe_load((repository / "deploy" / "kuberay-rayjob.yaml").read_text(encoding="utf-8"))
    cluster = job["spec"]["rayClusterSpec"]
    assert str(pins(repository / "requirements.txt")["ray"].specifier) == f"=={cluster['rayVersion']}"
    for group in (cluster["headGroupSpec"], *cluster["workerGroupSpecs"]):
        pod = group["template"]["spec"]
        assert pod["securityContext"]["runAsNonRoot"] is True
        assert all("limits" in container["resources"] for container in pod["containers"])
