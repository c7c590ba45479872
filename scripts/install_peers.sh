#!/bin/sh
# Install the peer solvers of the benchmarks into the given Python; solvers that cannot be installed are omitted.
# They are not dependencies of resgrid (kvxopt is under the GPL), so they have a separate virtual environment.
# scikit-fmm has no wheels; it is built if a compiler is available.
set -eu

python=$1

for peer in pyamg pypardiso kvxopt apxchol cholespy threadpoolctl spicelib InSpice PySpice ompl scikit-fmm pathfinding pathplanning \
    distributed loky mpi4py mpich parsl; do
    "$python" -m pip install --quiet --disable-pip-version-check --only-binary :all: --no-binary scikit-fmm "$peer" >/dev/null 2>&1 ||
        printf 'benchmarks: %s cannot be installed and is omitted from the table\n' "$peer" >&2
done

# The Debian package of PETSc for Debian's own Python includes hypre; building from source would take half an hour.
"${0%/*}/install_petsc.sh" >/dev/null || true
