#!/bin/sh
# Repeat every hypothesis test with random seeds, then read mutated decks, perform random actions on the live page,
# and solve circuits whose values cancel.  Usage: scripts/fuzz.sh PYTHON, with SEED (default: random), ROUNDS of the
# tests, COUNT of decks, ACTIONS on the page, and CIRCUITS.
set -eu
python=$1
seed=${SEED:-$("$python" -c 'import secrets; print(secrets.randbelow(10**9))')}
rounds=${ROUNDS:-5}
echo "seed $seed (again: make fuzz SEED=$seed)"

status=0
round=0
while [ "$round" -lt "$rounds" ]; do
    here=$((seed + round))
    echo "round $((round + 1)) of $rounds: --hypothesis-seed=$here"
    "$python" -m pytest -q -n "${JOBS:-2}" -m hypothesis --hypothesis-profile=fuzz --hypothesis-seed="$here" || status=1
    round=$((round + 1))
done
# These parts may take longer than the limit of ten minutes, which ends a test that hangs.
long="-m pytest -q --timeout=0"
RESGRID_MUTATED_DECKS=${COUNT:-100000} "$python" $long --hypothesis-profile=fuzz --hypothesis-seed="$seed" \
    tests/spice/read/test_mutated_decks.py || status=1
RESGRID_PAGE_ACTIONS=${ACTIONS:-10000} RESGRID_PAGE_SEED=$seed "$python" $long -o log_cli=true -o log_cli_level=INFO \
    tests/live_page/test_fuzzing.py || status=1
RESGRID_CIRCUITS=${CIRCUITS:-20000} RESGRID_SEED=$seed "$python" $long tests/circuit/test_cancellation.py || status=1
exit "$status"
