#!/usr/bin/env bash
# Prints the path of a Python 3.11 or 3.12 that can make virtual environments. PYTHON, if set, is the only candidate.
set -euo pipefail

check='import sys, ensurepip, venv; assert (3, 11) <= sys.version_info[:2] <= (3, 12); print(sys.executable)'
candidates=(python3.11 python3.12 python3 python /usr/bin/python3.11 /usr/bin/python3.12)
if [ -n "${PYTHON:-}" ]; then candidates=("$PYTHON"); fi
for candidate in "${candidates[@]}"; do
    if found="$("$candidate" -c "$check" 2>/dev/null)"; then
        echo "$found"
        exit 0
    fi
done
echo "error: Python 3.11 or 3.12 with the venv module is needed and was not found${PYTHON:+ at $PYTHON}:" \
    "install it (Debian 12: python3 and python3-venv; Ubuntu 22.04: python3.11-venv; 24.04: python3.12-venv)" \
    "or name one, make setup PYTHON=/path/to/python3.11" >&2
exit 1
