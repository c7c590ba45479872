#!/bin/sh
# Run a small set of tests with the lowest and with the newest versions of the packages that pyproject.toml permits.
# Usage: scripts/check_versions.sh [lowest] [newest].  Both by default.
# PYTHON: the interpreter (default: python3); FOLDER: folder of the environments (default: .venv-versions).
set -eu
python=${PYTHON:-python3}
mkdir -p "${FOLDER:-.venv-versions}"
folder=$(cd "${FOLDER:-.venv-versions}" && pwd)
[ $# -gt 0 ] || set -- lowest newest

tests="tests/core/test_netlist.py tests/internal/test_errors.py tests/internal/test_validation.py
tests/internal/test_versions.py"

"$python" -m venv "$folder/tools"
"$folder/tools/bin/python" -m pip install --quiet --disable-pip-version-check uv
uv=$folder/tools/bin/uv

for versions in "$@"; do
    case $versions in
        lowest) resolution=lowest-direct ;;
        newest) resolution=highest ;;
        *) echo "unknown versions '$versions': use lowest or newest" >&2; exit 2 ;;
    esac
    environment=$folder/$versions
    "$python" -m venv --clear "$environment"
    "$uv" pip compile --quiet --resolution "$resolution" --python "$environment/bin/python" pyproject.toml \
        --output-file "$folder/$versions.txt"
    "$uv" pip install --quiet --python "$environment/bin/python" --requirement "$folder/$versions.txt" \
        pytest hypothesis mpmath
    "$uv" pip install --quiet --python "$environment/bin/python" --no-deps .
    "$environment/bin/python" --version
    grep -E '^(numba|numpy|scipy|pydantic|matplotlib)==' "$folder/$versions.txt" | tr '\n' ' '
    echo
    NUMBA_CACHE_DIR=$folder/cache-$versions "$environment/bin/python" -m pytest -q --no-header \
        --override-ini pythonpath=tests --override-ini filterwarnings=default -p no:cacheprovider $tests
done
