#!/bin/sh
# Installs the solvers that resgrid is measured against into the Python given; what cannot be had is left out of the table.
# Nothing here is a dependency of resgrid (kvxopt, for one, is under the GPL): they live in a venv of their own.
# scikit-fmm has no wheels; it is built where there is a compiler.
set -eu

python=$1

for peer in pyamg pypardiso kvxopt apxchol cholespy threadpoolctl spicelib InSpice PySpice ompl scikit-fmm pathfinding \
    distributed loky mpi4py mpich parsl; do
    "$python" -m pip install --quiet --disable-pip-version-check --only-binary :all: --no-binary scikit-fmm "$peer" >/dev/null 2>&1 ||
        printf 'benchmarks: %s cannot be installed; the table will do without it\n' "$peer" >&2
done

# PETSc brings hypre along as a Debian package for Debian's own Python; as source it would take half an hour to build.
"${0%/*}/install_petsc.sh" >/dev/null || true
