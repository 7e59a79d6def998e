#!/usr/bin/env bash
# The whole test suite as two halves side by side: what computes, and what mostly waits for clusters.
# Usage: scripts/test.sh PYTHON
set -uo pipefail
cd "$(dirname "$0")/.."
python=$1
log=$(mktemp)
trap 'kill -INT "$computing" 2>/dev/null; wait "$computing" 2>/dev/null; rm -f "$log"' EXIT
trap 'exit 130' INT TERM

# Of the services, what needs no cluster; the demonstration starts one, and two do not go side by side.
alone=(tests/services/test_api_*.py)
others=(tests/test_*.py "${alone[@]}")
for room in tests/*/; do
  case $room in
    tests/services/ | */__pycache__/) ;;
    *) others+=("$room") ;;
  esac
done

echo "tests/services on this screen; all other tests, those of its interface too, beside it, shown when both are done"
# A job in the background ignores Ctrl-C unless it is told not to: its servers and clusters would outlive it.
listening='import signal, sys, pytest
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.exit(pytest.main(sys.argv[1:]))'
"$python" -c "$listening" "${others[@]}" -p no:cacheprovider >"$log" 2>&1 &
computing=$!
"$python" -m pytest tests/services "${alone[@]/#/--ignore=}"
services=$?
wait "$computing"
rest=$?
echo "== all other tests"
cat "$log"
[ "$services" = 0 ] && [ "$rest" = 0 ]
