"""PETSc's ranks as processes of their own: found, started with mpiexec, reported when one dies, ended on Ctrl-C.

Debian's PETSc belongs to Debian's own Python: `resgrid.solvers.petsc_worker` runs in that one, with the mpiexec beside
it, and speaks through files.  ``RESGRID_PETSC_PYTHON`` names another Python that can import petsc4py.
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import warnings
import weakref
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from resgrid.errors import AccuracyError, InputError, ToolMissingError

PYTHON_VARIABLE = "RESGRID_PETSC_PYTHON"
_DEBIAN = "/usr/lib/petscdir"
_REMEDY = (
    "method 'petsc' needs PETSc with petsc4py and mpiexec, and {what}: on Debian and Ubuntu type 'sudo apt-get install "
    f"python3-petsc4py openmpi-bin', or set {PYTHON_VARIABLE} to a Python that imports petsc4py, mpiexec beside it"
)
_WORKER = Path(__file__).with_name("petsc_worker.py")
_LAST_WORDS = 3
_PATIENCE = 5.0


@dataclass(frozen=True)
class Report:
    """How a system was solved: steps, residual of the right-hand side's norm, seconds of stages, each rank's memory.

    `peaks`: bytes, one for each rank, pages of mapped files included.
    """

    iterations: int
    error: float
    preconditioner: str
    seconds: Mapping[str, float]
    peaks: tuple[int, ...]


class Petsc(NamedTuple):
    """The mpiexec and the Python that have PETSc, and the environment they run in."""

    mpiexec: str
    python: str
    environment: dict[str, str]


def find_petsc() -> Petsc:
    """Find PETSc; raises `ToolMissingError`, which says how to get it."""
    python = os.environ.get(PYTHON_VARIABLE) or "/usr/bin/python3"
    mpiexec = Path(python).with_name("mpiexec")
    for what in (Path(python), mpiexec):
        if not os.access(what, os.X_OK):
            raise ToolMissingError(_REMEDY.format(what=f"there is no {what}"))
    builds = sorted(Path(_DEBIAN).glob("*/*-real*"), reverse=True)
    reasons = []
    for petsc in (*builds, None):
        environment = _environment(petsc)
        probe = subprocess.run(
            [python, "-s", "-c", "import numpy, petsc4py.PETSc"],
            env={**environment, "PETSC_OPTIONS": ""}, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE, text=True, errors="replace", check=False, timeout=60,
        )  # fmt: skip
        if probe.returncode == 0:
            return Petsc(str(mpiexec), python, environment)
        reasons.append(_last_words(probe.stderr))
    raise ToolMissingError(_REMEDY.format(what=f"{python} cannot import petsc4py ({reasons[0]})"))


def run_ranks(petsc: Petsc, folder: Path, ranks: int) -> Report:
    """Solve the system that a folder holds on so many ranks.

    Raises
    ------
    InputError
        If PETSc refuses an option of ``PETSC_OPTIONS``.
    AccuracyError
        If a rank fails or dies; the others are ended.
    """
    log = folder / "log"
    with log.open("wb") as out:
        process = subprocess.Popen(
            [petsc.mpiexec, "-n", str(ranks), petsc.python, "-s", str(_WORKER), str(folder)],
            env=petsc.environment, stdin=subprocess.DEVNULL, stdout=out, stderr=subprocess.STDOUT,
            start_new_session=True,
        )  # fmt: skip
        ending = weakref.finalize(process, _end, process)  # also where the thread that waits is left behind
        try:
            status = process.wait()
        finally:  # Ctrl-C leaves no rank behind
            ending.detach()
            if process.poll() is None:
                _end(process)
    report, refused = folder / "report.json", folder / "refused"
    if refused.exists():
        raise InputError(f"PETSc refuses an option of PETSC_OPTIONS: {refused.read_text()}; correct or unset it")
    said = log.read_text("utf-8", "replace")
    if status != 0 or not report.exists():
        raise AccuracyError(f"PETSc ended without an answer (mpiexec's exit status {status}): {_last_words(said)}")
    unused = re.findall(r"^Option left: name:(-\S+)", said, re.MULTILINE)
    if unused:
        warnings.warn(f"PETSc has no use for {', '.join(unused)} of PETSC_OPTIONS", stacklevel=2)
    peaks = tuple(int((folder / f"peak_{rank}.json").read_text()) for rank in range(ranks))
    return Report(**json.loads(report.read_text()), peaks=peaks)


def _environment(petsc: Path | None) -> dict[str, str]:
    """What the ranks find: Debian's PETSc; one thread each, as many as asked for, asleep while they wait."""
    given = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "VIRTUAL_ENV"))}
    given |= {
        "OPENBLAS_NUM_THREADS": "1",
        "OMP_NUM_THREADS": "1",
        "OMPI_MCA_rmaps_base_oversubscribe": "1",
        "OMPI_MCA_hwloc_base_binding_policy": "none",
        "OMPI_MCA_mpi_yield_when_idle": "1",
    }
    if petsc is not None:
        given |= {"PETSC_DIR": str(petsc), "PYTHONPATH": str(petsc / "lib/python3/dist-packages")}
    if hasattr(os, "geteuid") and os.geteuid() == 0:  # in a container, where Open MPI asks twice
        given |= {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
    return given


def _end(process: subprocess.Popen[bytes]) -> None:
    """End mpiexec, which ends its ranks; if it does not in time, by force."""
    process.terminate()
    try:
        process.wait(_PATIENCE)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def _last_words(log: str) -> str:
    """The lines that say why: exceptions, and which rank was killed."""
    lines = [line.strip() for line in log.splitlines()]
    telling = [line for line in lines if "Error" in line or "signal" in line or "exited" in line]
    return "; ".join(dict.fromkeys(telling[:_LAST_WORDS])) or " ".join(lines[-_LAST_WORDS:]) or "it said nothing"
