#!/bin/sh
# Installs the solvers that resgrid is measured against into the Python given; what cannot be had is left out of the table.
# Nothing here is a dependency of resgrid (kvxopt, for one, is under the GPL): they live in a venv of their own.
# scikit-fmm has no wheels; it is built where there is a compiler.
set -eu

python=$1

for peer in pyamg pypardiso kvxopt apxchol cholespy threadpoolctl spicelib InSpice PySpice ompl scikit-fmm pathfinding; do
    "$python" -m pip install --quiet --disable-pip-version-check --only-binary :all: --no-binary scikit-fmm "$peer" >/dev/null 2>&1 ||
        printf 'benchmarks: %s cannot be installed; the table will do without it\n' "$peer" >&2
done

# PETSc brings hypre along as a Debian package for Debian's own Python; as source it would take half an hour to build.
if ls /usr/lib/petscdir/*/*-real/lib/python3/dist-packages/petsc4py >/dev/null 2>&1; then
    exit 0
fi
if command -v apt-get >/dev/null 2>&1 && [ "$(id -u)" = 0 ]; then
    apt-get update -qq || true
    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends python3-petsc4py >/dev/null 2>&1 && exit 0
fi
printf 'benchmarks: PETSc is missing; for it type: sudo apt-get install -y python3-petsc4py\n' >&2
