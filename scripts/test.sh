#!/usr/bin/env bash
# The whole test suite as two halves side by side: what computes, and what mostly waits for servers and clusters.
# Usage: scripts/test.sh PYTHON
set -uo pipefail
cd "$(dirname "$0")/.."
python=$1
log=$(mktemp)
trap 'kill "$computing" 2>/dev/null; rm -f "$log"' EXIT
trap 'exit 130' INT TERM

echo "tests/services on this screen; all other tests beside it, shown when both are done"
"$python" -m pytest --ignore=tests/services -p no:cacheprovider >"$log" 2>&1 &
computing=$!
"$python" -m pytest tests/services
services=$?
wait "$computing"
others=$?
echo "== all other tests"
cat "$log"
[ "$services" = 0 ] && [ "$others" = 0 ]
