#!/bin/sh
# Install PETSc for Debian's own Python, which solves grids that do not fit in memory (--method petsc), unless it is
# installed.  If the installation is not possible, stop with the command to run.  RESGRID_PETSC_PYTHON selects another
# Python with petsc4py.
set -eu
. "${0%/*}/by_apt.sh"

stop() {
    printf "PETSc is missing, and --method petsc needs it. %s\n" "$1" >&2
    exit 1
}

if [ -n "${RESGRID_PETSC_PYTHON:-}" ]; then
    "$RESGRID_PETSC_PYTHON" -c 'import petsc4py.PETSc' 2>/dev/null && exit 0
    stop "RESGRID_PETSC_PYTHON names $RESGRID_PETSC_PYTHON, which has no petsc4py: correct or unset it."
fi
for build in /usr/lib/petscdir/*/*-real*/lib/python3/dist-packages; do
    if [ -d "$build/petsc4py" ] && [ -x /usr/bin/mpiexec ]; then exit 0; fi
done
command -v apt-get >/dev/null 2>&1 || stop "Install petsc4py and mpiexec for a Python, and name it in RESGRID_PETSC_PYTHON."
by_apt python3-petsc4py openmpi-bin
