"""`make setup` in a checkout of its own, with a stand-in for the interpreter: nothing is installed."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

STAND_IN = """#!/bin/sh
case "$1 $2" in
  "-c "*) echo "$0" ;;
  "-m venv")
    for folder; do :; done
    [ "$3" != --clear ] || find "$folder" -mindepth 1 -delete
    mkdir -p "$folder/bin"
    touch "$folder/pyvenv.cfg"
    [ -L "$folder/bin/python" ] || ln -s "$0" "$folder/bin/python" ;;
esac
case "$*" in
  *"-m venv"* | *"pip install"*) echo "$*" >>"$(dirname "$(readlink -f "$0")")/asked" ;;
esac
"""
"""Makes an environment as Python does, links that lead nowhere included, and notes what it installs."""

INSTALLED = 2
"""Calls of pip: the pinned requirements, then this project."""


class Checkout:
    """A checkout with what set-up needs of it.

    Args:
        folder: the checkout.
        python: the stand-in.
    """

    def __init__(self, folder: Path, python: Path) -> None:
        self.folder = folder
        self.python = python

    def setup(self, *arguments: str) -> list[str]:
        """What the interpreter was asked for by one ``make setup``."""
        asked = self.python.with_name("asked")
        asked.write_text("")
        own = {name: value for name, value in os.environ.items() if not name.startswith(("MAKE", "MFLAGS"))}
        subprocess.run(
            ["make", "setup", *arguments],
            cwd=self.folder,
            env={**own, "PYTHON": str(self.python)},
            capture_output=True,
            check=True,
        )
        return asked.read_text().splitlines()


@pytest.fixture
def checkout(repository: Path, tmp_path: Path) -> Checkout:
    folder, python = tmp_path / "drape tests", tmp_path / "interpreter" / "python3.11"
    (folder / "scripts").mkdir(parents=True)
    for name in ("Makefile", "scripts/setup.sh", "scripts/find-python.sh"):
        shutil.copy(repository / name, folder / name)
    for name in ("requirements.txt", "requirements-dev.txt", "pyproject.toml"):
        (folder / name).touch()
    for program, text in ((folder / "scripts" / "system-packages.sh", "#!/bin/sh\n"), (python, STAND_IN)):
        program.parent.mkdir(exist_ok=True)
        program.write_text(text)
        program.chmod(0o755)
    return Checkout(folder, python)


def test_an_environment_is_set_up_once(checkout: Checkout) -> None:
    assert checkout.setup()[0] == "-m venv .venv"
    assert checkout.setup() == []


def test_an_environment_of_an_earlier_set_up_is_kept(checkout: Checkout) -> None:
    """Which folder it was made in is not known of it."""
    checkout.setup()
    (checkout.folder / ".venv" / ".ready").write_text("")
    assert len(checkout.setup()) == INSTALLED
    assert checkout.setup() == []


@pytest.mark.parametrize("how", [["mv"], ["cp", "-a"]])
def test_an_environment_that_was_moved_or_copied_is_made_anew(
    how: list[str], checkout: Checkout, tmp_path: Path
) -> None:
    """Its programs, and where it finds this project, name the old folder."""
    checkout.setup()
    subprocess.run([*how, checkout.folder, tmp_path / "new"], check=True)
    other = Checkout(tmp_path / "new", checkout.python)
    assert other.setup()[0] == "-m venv --clear .venv"
    assert other.setup() == []


def test_an_environment_whose_interpreter_is_gone_is_made_anew(checkout: Checkout) -> None:
    checkout.setup()
    (checkout.folder / ".venv" / "bin" / "python").unlink()
    (checkout.folder / ".venv" / "bin" / "python").symlink_to("/nowhere/python3.11")
    assert checkout.setup()[0] == "-m venv --clear .venv"
    assert checkout.setup() == []


def test_an_environment_elsewhere_is_given_to_the_checkout_that_asks(checkout: Checkout, tmp_path: Path) -> None:
    """It was not moved itself: what others of its users need is not taken away."""
    checkout.setup(f"VENV={tmp_path / 'venv'}")
    checkout.folder = checkout.folder.rename(tmp_path / "new")
    assert len(checkout.setup(f"VENV={tmp_path / 'venv'}")) == INSTALLED
    assert checkout.setup(f"VENV={tmp_path / 'venv'}") == []
