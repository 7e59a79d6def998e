#!/usr/bin/env bash
# System packages, virtual environment, pinned requirements, this project in place. Called by `make setup`.
# VENV: folder of the environment (default .venv); one that was moved or copied, or whose interpreter is gone, is made
# anew. PYTHON: interpreter to make it with.
# TORCH_INDEX: a package index that is asked for PyTorch too, e.g. https://download.pytorch.org/whl/cpu, which spares the
# CUDA libraries on a machine without such a device.
set -euo pipefail
cd "$(dirname "$0")/.."
venv="${VENV:-.venv}"

glibc="$(getconf GNU_LIBC_VERSION 2>/dev/null | cut -d ' ' -f 2)" || true
if [ "$(uname -sm)" != "Linux x86_64" ] || [ "$(printf '%s\n' 2.35 "${glibc:-0}" | sort -V | head -n 1)" != 2.35 ]; then
    echo "error: this is $(uname -sm) with glibc ${glibc:-unknown}: Open3D and Taichi are built for Linux x86_64 with" \
        "glibc 2.35 or later (Debian 12, Ubuntu 22.04)" >&2
    exit 1
fi
scripts/system-packages.sh
# what is in it names its folder and its interpreter in full
anew=
if [ -f "$venv/pyvenv.cfg" ] && [ -L "$venv/bin/python" ] && ! "$venv/bin/python" -SEc '' 2>/dev/null; then
    anew="its interpreter $(readlink -m "$venv/bin/python") does not run"
elif [ -s "$venv/.ready" ] && [ "$(sed -n 2p "$venv/.ready")" != "$(realpath "$venv")" ]; then
    anew="it was made in $(sed -n 2p "$venv/.ready")"
fi
if [ -z "$anew" ] && [ -x "$venv/bin/python" ]; then
    if ! "$venv/bin/python" -c 'import sys; assert (3, 11) <= sys.version_info[:2] <= (3, 12)' 2>/dev/null; then
        echo "error: $venv holds $("$venv/bin/python" --version 2>&1 || true), and Python 3.11 or 3.12 is needed:" \
            "remove it, or name another folder, make setup VENV=FOLDER" >&2
        exit 1
    fi
    if [ -n "${PYTHON:-}" ]; then echo "$venv is there: PYTHON=$PYTHON is not used (remove $venv to make it anew)"; fi
else
    python="$(scripts/find-python.sh)"
    echo "making $venv${anew:+ anew, since $anew,} with $("$python" --version)"
    "$python" -m venv ${anew:+--clear} "$venv"
fi
# one that was cut off while it was made, or was made without it, has no pip yet
"$venv/bin/python" -m pip --version >/dev/null 2>&1 || "$venv/bin/python" -m ensurepip
echo "installing the pinned requirements (a few minutes the first time)"
"$venv/bin/python" -m pip install --quiet --disable-pip-version-check \
    ${TORCH_INDEX:+--extra-index-url "$TORCH_INDEX"} --requirement requirements-dev.txt
"$venv/bin/python" -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
realpath . "$venv" >"$venv/.ready"
echo "ready: $venv/bin/drapemeter --help"
