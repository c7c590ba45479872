"""Run PETSc's ranks (MPI processes): find PETSc, start the ranks, report failures, end them on Ctrl-C.

Debian's PETSc belongs to Debian's own Python: `resgrid.solvers.petsc_worker` runs in that Python, started by the
mpiexec of the same folder, and exchanges data through files.  ``RESGRID_PETSC_PYTHON`` names another Python that can
import petsc4py.  A launcher, such as ``srun -n 64``, replaces ``mpiexec -n N``: the launcher then sets the number of
ranks, and may start them on other computers that share the folder of the files.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import warnings
import weakref
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from resgrid._internal.subprocesses import kill_session
from resgrid.errors import AccuracyError, InputError, ToolMissingError

PYTHON_VARIABLE = "RESGRID_PETSC_PYTHON"
_DEBIAN = "/usr/lib/petscdir"
_REMEDY = (
    "method 'petsc' needs PETSc with petsc4py and mpiexec, and {problem}: on Debian and Ubuntu type 'sudo apt-get "
    f"install python3-petsc4py openmpi-bin', or set {PYTHON_VARIABLE} to a Python that imports petsc4py, mpiexec in "
    "its folder"
)
_WORKER = Path(__file__).with_name("petsc_worker.py")

_LAST_WORDS = 3
"""Number of lines of PETSc's output that an error message quotes."""

_PATIENCE = 5.0
"""Time, in seconds, in which the launcher must end its ranks after a termination signal; then all are killed."""


@dataclass(frozen=True)
class Report:
    """Statistics of a solve by PETSc.

    `iterations`: number of iterations; `error`: residual norm relative to that of the right-hand side;
    `preconditioner`: PETSc's name of the preconditioner; `seconds`: time of the stages "load" (reading and assembly),
    "factor" (setup of the preconditioner) and "substitute" (iterations), in seconds; `peaks`: peak memory of every rank
    in bytes, including pages of mapped files.
    """

    iterations: int
    error: float
    preconditioner: str
    seconds: Mapping[str, float]
    peaks: tuple[int, ...]


class Petsc(NamedTuple):
    """The Python that has PETSc, and the command that starts the ranks (MPI processes).

    `python`: path of the Python; `environment`: environment variables of the ranks; `launcher`: words of a command that
    includes the number of ranks; None for the mpiexec in the folder of `python`.
    """

    python: str
    environment: dict[str, str]
    launcher: tuple[str, ...] | None = None

    def command(self, ranks: int | None) -> list[str]:
        """Return the words of the command that starts the ranks, without the Python program that follows.

        `ranks`: number of ranks for mpiexec; ignored, and possibly None, with a launcher.
        """
        prefix = self.launcher or (str(_mpiexec_of(self.python)), "-n", str(ranks))
        return [*prefix, self.python, "-s"]


def find_petsc(launcher: str | None = None) -> Petsc:
    """Return a Python that has PETSc, and the launcher of the ranks.

    Parameters
    ----------
    launcher : str, optional
        Command that starts the ranks, their number included, such as ``"srun -n 64"``; ``mpiexec -n N`` by default.

    Returns
    -------
    Petsc
        Python, environment and launcher.

    Raises
    ------
    ToolMissingError
        If PETSc, mpiexec or the program of the launcher is missing; the message contains a remedy.
    InputError
        If the launcher is not a command.
    """
    words = None if launcher is None else _words_of(launcher)
    python = os.environ.get(PYTHON_VARIABLE) or "/usr/bin/python3"
    for program in (Path(python), *([] if words else [_mpiexec_of(python)])):
        if not os.access(program, os.X_OK):
            raise ToolMissingError(_REMEDY.format(problem=f"there is no {program}"))
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
            return Petsc(python, environment, words)
        reasons.append(_last_words(probe.stderr))
    raise ToolMissingError(_REMEDY.format(problem=f"{python} cannot import petsc4py ({reasons[0]})"))


def _mpiexec_of(python: str) -> Path:
    """Return the path of the mpiexec in the folder of the Python with path `python`; the file may not exist."""
    return Path(python).with_name("mpiexec")


def _words_of(launcher: str) -> tuple[str, ...]:
    """Return the words of a launcher, with the full path of its program as the first word.

    `launcher`: command as one string. Raises InputError if it is not a command, ToolMissingError if there is no such
    program.
    """
    try:
        words = shlex.split(launcher)
    except ValueError as error:
        raise InputError(f"launcher = {launcher!r} is not a command ({error}); correct its quotes") from error
    if not words:
        raise InputError(f"launcher = {launcher!r} is empty; give one, such as 'srun -n 64', or leave it out")
    program = shutil.which(words[0])
    if program is None:
        raise ToolMissingError(
            f"launcher = {launcher!r}: there is no program {words[0]!r}; correct its name or path, or leave the "
            "launcher out to use mpiexec"
        )
    return program, *words[1:]


def run_ranks(petsc: Petsc, folder: Path, ranks: int | None) -> Report:
    """Solve the system of equations in a folder with PETSc's ranks, and return the statistics of the solve.

    Parameters
    ----------
    petsc : Petsc
        Python, environment and launcher.
    folder : Path
        Folder with the system of equations (see `resgrid.solvers.petsc_worker`), which receives the solution.
    ranks : int or None
        Number of ranks; None if the launcher sets it.

    Returns
    -------
    Report
        Statistics of the solve.

    Raises
    ------
    InputError
        If PETSc refuses an option of ``PETSC_OPTIONS``, or the launcher belongs to another MPI than PETSc.
    AccuracyError
        If a rank fails or dies; the other ranks are ended.
    ToolMissingError
        If the launcher cannot be started.
    """
    log, program = folder / "log", [str(_WORKER), str(folder)]
    if petsc.launcher is not None:  # other computers may have the folder, but not this installation
        program = [str(shutil.copy(str(_WORKER), folder)), str(folder), "shared"]
    status = _run([*petsc.command(ranks), *program], petsc, log)
    report, refused, foreign = folder / "report.json", folder / "refused", folder / "foreign"
    if foreign.exists():
        command = shlex.join(petsc.command(ranks)[:-2])
        raise InputError(
            f"the launcher {command} belongs to another MPI than PETSc ({foreign.read_text()}); give the launcher of "
            f"PETSc's MPI, or set {PYTHON_VARIABLE} to a Python whose petsc4py uses this MPI"
        )
    if refused.exists():
        raise InputError(f"PETSc refuses an option of PETSC_OPTIONS: {refused.read_text()}; correct or unset it")
    said = log.read_text("utf-8", "replace")
    if status != 0 or not report.exists():
        needs = (
            f"; every computer needs the folder {folder.parent} (TMPDIR) and {petsc.python}" if petsc.launcher else ""
        )
        raise AccuracyError(
            f"PETSc ended without an answer (the launcher's exit status is {status}): {_last_words(said)}{needs}"
        )
    unused = re.findall(r"^Option left: name:(-\S+)", said, re.MULTILINE)
    if unused:
        warnings.warn(f"PETSc has no use for {', '.join(unused)} of PETSC_OPTIONS", stacklevel=2)
    data = json.loads(report.read_text())
    peaks = tuple(int((folder / f"peak_{rank}.json").read_text()) for rank in range(data.pop("ranks")))
    return Report(**data, peaks=peaks)


def _run(command: list[str], petsc: Petsc, log: Path) -> int:
    """Run the launcher, end it on Ctrl-C, and return its exit status.

    `command`: words of the command; `petsc`: provides the environment variables of the ranks; `log`: file that receives
    the output. Raises ToolMissingError if the launcher cannot be started.
    """
    with log.open("wb") as out:
        try:
            process = subprocess.Popen(
                command, env=petsc.environment, stdin=subprocess.DEVNULL, stdout=out, stderr=subprocess.STDOUT,
                start_new_session=True,
            )  # fmt: skip
        except OSError as error:
            raise ToolMissingError(
                f"{command[0]} cannot be run ({error.strerror}): correct the launcher, or leave it out to use mpiexec"
            ) from error
        ending = weakref.finalize(process, _end, process)  # also if the waiting thread is abandoned
        try:
            return process.wait()
        finally:  # Ctrl-C leaves no rank behind
            ending.detach()
            if process.poll() is None:
                _end(process)


def _environment(petsc: Path | None) -> dict[str, str]:
    """Return the environment variables of the ranks.

    `petsc`: folder of a Debian build of PETSc, None for a PETSc that Python finds by itself. Every rank has one thread;
    ranks do not wait busily, and their number is not limited by the number of cores.
    """
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
    """End the launcher, which ends its ranks; kill all of them if this takes more than five seconds."""
    process.terminate()
    try:
        process.wait(_PATIENCE)
    except subprocess.TimeoutExpired:
        kill_session(process)


def _last_words(log: str) -> str:
    """Return up to three lines of a log that report errors, joined to one line; without such lines the last three.

    `log`: text of the log. A line reports an error if it contains "Error", "signal" or "exited". For an empty log the
    result is "its log is empty".
    """
    lines = [line.strip() for line in log.splitlines()]
    telling = [line for line in lines if "Error" in line or "signal" in line or "exited" in line]
    return "; ".join(dict.fromkeys(telling[:_LAST_WORDS])) or " ".join(lines[-_LAST_WORDS:]) or "its log is empty"
