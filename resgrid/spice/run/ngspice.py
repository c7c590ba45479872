"""Operating points by runs of ngspice on a deck, and functions for the runs of other engines and analyses.

Success is judged by the messages and the raw file of the simulator, never by its exit status.
"""

from __future__ import annotations

import contextlib
import math
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np

from resgrid._internal.files import temporary_folder
from resgrid._internal.subprocesses import kill_session
from resgrid.errors import BudgetError, InputError, ToolMissingError
from resgrid.spice.run.rawfile import RawFile, read_rawfile

if sys.platform == "linux":
    import resource

EXECUTABLE_VARIABLE = "RESGRID_NGSPICE"
INSTALL = (
    "the circuit simulator {name} is not installed: 'sudo apt-get install ngspice' (Debian, Ubuntu), "
    f"'brew install ngspice' (macOS), or set {EXECUTABLE_VARIABLE} to the program"
)
_DECK, RAW, _LOG = "deck.cir", "operating_point.raw", "log.txt"
_RUN = '* operating point of {deck}\n.include "{deck}"\n.options klu\n.op\n.end\n'
_PLOT = "Operating Point"
_MAX_LOG = 2**20
"""Maximum number of bytes that are read from the beginning of a simulator's log; later messages are ignored."""
_MAX_SECONDS = 2**31
"""Upper bound, in seconds, of the limit that is set on the processor time of a simulator run, whatever its timeout."""
_MAX_COMPLAINTS = 10
"""Maximum number of different lines with a warning or error of the simulator that `SimulatorRun.complaints` holds."""
MAX_ASCENT = 8
"""Maximum number of leading ``..`` in the name of an included file.

The deck runs in a folder at this nesting depth of the temporary folder, so that ``..`` cannot lead outside.
"""
_VERSION = re.compile(r"ngspice-(\d[\w.+-]*)")
_COMPLAINT = re.compile(
    r"warning|error|fatal|singular|gmin|source step|transient op|no convergence|timestep|abort|fail|unable|cannot|"
    r"can't|could not|not found|unknown|unrecognized|undefined|missing|floating|short|too (few|many|low|small)|"
    r"already exists|not parsed|illegal|invalid|ignored|set to",
    re.IGNORECASE,
)
_HARMLESS = re.compile(
    r"no compatibility mode|initialization file spinit|spinit|no \"\.plot\"|direct linear solver|klu|"
    r"no resource usage|no active circuit|^trying gmin|^supplies reduced|further gmin|^note: one successful|"
    r"^note: starting (dynamic|true) gmin stepping$|^note: (dynamic|true) gmin stepping completed$",
    re.IGNORECASE,
)
# ngspice recognizes commands by their first letters, ignores carriage returns anywhere, and reads a file with the title
# *ng_script as a script; its code models (elements A) open files and run programs.
_BOM = b"\xef\xbb\xbf"
_COMMANDS = rb"\*#|\*ng_script|\.(?:control|exec|csparam)\w*"
_FILES, _MODELS, _CODE_MODELS = rb"|\.(?:inc|lib)\w*", rb"|\.(?:model|func)\w*", rb"|(?<=\n)[ \t\v\f]*a\S*"
VERSIONS = ("39", "46")
"""Versions of ngspice that resgrid is tested with: those of Debian 12 and of its backports."""


@dataclass(frozen=True, eq=False)
class SimulatorRun:
    """Result of a simulator run.

    `voltage`: voltage of every node by name, in volts; empty without an operating point; `source_current`: current into
    the plus terminal of every voltage source by name, in amperes; `simulator, version`: name and version of the
    simulator, ``"unknown"`` if it prints no version; `complaints`: messages about a missing or unusable result, and
    warnings and errors that the simulator printed.
    """

    voltage: Mapping[str, float]
    source_current: Mapping[str, float]
    simulator: str
    version: str
    complaints: tuple[str, ...]


def simulate(
    data: bytes,
    *,
    source: str = "deck",
    timeout: float = 600.0,
    direct: bool = False,
    files: Mapping[str, bytes] = MappingProxyType({}),
    place: str = _DECK,
) -> SimulatorRun:
    """Compute the operating point of a deck's content with ngspice, in a temporary folder, and return the result.

    `data`: content of the deck; `source`: name of the deck in messages; `timeout`: longest run, in seconds; `direct`:
    whether the deck contains an analysis statement (if not, ``.op`` is added); `files`: content of the included files
    by path relative to the folder of the run; `place`: path of the deck in this folder.  A defective deck gives
    complaints in the result, not an exception.  Raises ToolMissingError if ngspice is not installed, InputError for a
    deck that could run commands or, without `files`, include files, and BudgetError after the timeout.
    """
    program = find_program(EXECUTABLE_VARIABLE, "ngspice", INSTALL)
    refuse_commands(data, source, models=direct, includes=bool(files))
    with temporary_folder() as folder:
        version = version_of(program, folder)
        own = folder.joinpath(*["_"] * MAX_ASCENT) if files else folder
        for where, content in {place: data, **files}.items():
            (own / where).parent.mkdir(parents=True, exist_ok=True)
            (own / where).write_bytes(content)
        if not direct:
            (folder / "run.cir").write_text(_RUN.format(deck=place), encoding="ascii")
        words = [program, "-n", "-b", "-r", str(folder / RAW), place if direct else "run.cir"]
        status = run_quietly(words, folder, timeout, source, cwd=own)
        return result_in(folder, "ngspice", version, status)


def ngspice_version() -> str:
    """Return the version of the installed ngspice, e.g. ``"39"``; ``"unknown"`` if it prints none."""
    with temporary_folder() as folder:
        return version_of(find_program(EXECUTABLE_VARIABLE, "ngspice", INSTALL), folder)


def find_program(variable: str, name: str, remedy: str) -> str:
    """Return the absolute path of the program `name`, or of the program that the environment variable `variable` names.

    `remedy`: message of the ToolMissingError that is raised if the program is not installed; ``{name}`` in this text
    stands for the name of the program.
    """
    named = os.environ.get(variable) or name
    path = shutil.which(named)
    if path is None:
        raise ToolMissingError(remedy.format(name=repr(named)))
    return str(Path(path).absolute())


def refuse_commands(data: bytes, source: str, *, models: bool = False, includes: bool = False) -> None:
    """Raise InputError for a deck that could run commands or read other files.

    `data`: content of the deck; `source`: name of the deck in messages; `models`: whether ``.model`` and ``.func`` are
    allowed (code models are then rejected); `includes`: whether statements that include files are allowed.
    """
    words = _COMMANDS + (b"" if includes else _FILES) + (_CODE_MODELS if models else _MODELS)
    forbidden = re.compile(rb"^\s*(" + words + rb")", re.IGNORECASE | re.MULTILINE)
    data = data.removeprefix(_BOM)
    for text in (data.replace(b"\r", b"\n"), data.replace(b"\r", b"")) if b"\r" in data else (data,):
        match = forbidden.search(text)
        if match:
            line = text.count(b"\n", 0, match.start(1)) + 1
            word = match.group(1).decode("ascii", "replace").strip()
            raise InputError(
                f"{source}, line {line}: {word!r} is not simulated, because it could run commands or read other files; "
                "remove it"
            )


def version_of(program: str, folder: Path) -> str:
    """Return the version that ngspice prints, ``"unknown"`` if it prints none within 10 s.

    `program`: path of ngspice; `folder`: folder for the log.
    """
    try:
        run_quietly([program, "--version"], folder, 10.0, "--version")
    except BudgetError:
        return "unknown"
    return version_in(folder)


def version_in(folder: Path) -> str:
    """Return the version of ngspice in the log of a folder, ``"unknown"`` if the log contains none."""
    match = _VERSION.search(_read_log(folder))
    return match.group(1) if match else "unknown"


def run_quietly(
    command: list[str], folder: Path, timeout: float, source: str, name: str = "ngspice", cwd: Path | None = None
) -> int:
    """Run a simulator with its output in a log in `folder`; return its exit status.

    `command`: program and arguments; `timeout`: longest run, in seconds; `source`: name of the deck in messages;
    `name`: name of the simulator; `cwd`: working folder, `folder` by default.  Raises ToolMissingError if the program
    cannot be run, and BudgetError after the timeout.
    """
    environment = {key: value for key, value in os.environ.items() if not key.startswith(("SPICE", "NGSPICE"))}
    environment |= {"LC_ALL": "C"}
    if name == "ngspice":
        environment |= {
            "OMP_NUM_THREADS": "1"
        }  # processor time then never exceeds wall-clock time, so the limit below holds
    with (folder / _LOG).open("wb") as log:
        try:
            process = subprocess.Popen(
                command,
                cwd=cwd or folder,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        except OSError as error:
            raise ToolMissingError(f"cannot run {command[0]}: {error.strerror}; reinstall {name}") from error
        _limit_processor_time(process.pid, timeout * (1 if name == "ngspice" else os.cpu_count() or 1))
        try:
            return process.wait(timeout)
        except subprocess.TimeoutExpired as error:
            raise BudgetError(
                f"{name} did not finish {source} within {timeout:g} s; allow more time or check a smaller grid"
            ) from error
        finally:  # after a timeout and after Ctrl-C
            kill_session(process)


def _limit_processor_time(pid: int, seconds: float) -> None:
    """Limit the processor time of process `pid` to about `seconds` (Linux only), even if this program is killed."""
    if sys.platform != "linux":
        return
    limit = min(math.ceil(seconds) + 1, _MAX_SECONDS)
    with contextlib.suppress(OSError, ValueError):  # the process has ended, or has a lower limit
        resource.prlimit(pid, resource.RLIMIT_CPU, (limit, limit))


def _read_log(folder: Path) -> str:
    """Return the first `_MAX_LOG` bytes of the log in a folder, as text."""
    with (folder / _LOG).open("rb") as log:
        return log.read(_MAX_LOG).decode("utf-8", "replace")


def result_in(folder: Path, simulator: str, version: str, status: int) -> SimulatorRun:
    """Return the result of a run from the raw file and the log that the simulator wrote to `folder`.

    `simulator, version`: name and version of the simulator; `status`: its exit status, which appears in messages only.
    """
    complaints = complaints_in(folder, simulator)
    try:
        raw = _operating_point(folder)
    except InputError as error:
        return SimulatorRun({}, {}, simulator, version, (f"{error} (exit status {status})", *complaints))
    read: dict[str, dict[str, float]] = {"voltage": {}, "current": {}}
    for name, kind, value in zip(raw.names, raw.kinds, raw.values[0].tolist(), strict=True):
        # n_0_0 from v(n_0_0), v_obstacle from i(v_obstacle) or v_obstacle#branch; a node called time has the kind time
        read["current" if kind == "current" else "voltage"][bare_name(name).removesuffix("#branch")] = value
    return SimulatorRun(read["voltage"], read["current"], simulator, version, complaints)


def complaints_in(folder: Path, simulator: str) -> tuple[str, ...]:
    """Return at most 10 different warnings and errors in the log of a run, without messages known to be harmless.

    `folder`: folder of the log; `simulator`: name of the simulator, with which each message begins.
    """
    lines = (re.sub(r"\s+", " ", line).strip() for line in re.split(r"[\r\n]+", _read_log(folder)))
    bad = dict.fromkeys(line for line in lines if _COMPLAINT.search(line) and not _HARMLESS.search(line))
    return tuple(f"{simulator} says: {line[:200]}" for line in list(bad)[:_MAX_COMPLAINTS])


def bare_name(name: str) -> str:
    """Return the name of a node or an element from that of a variable in a raw file: ``n_0_0`` for ``v(n_0_0)``."""
    inner = name[2:-1] if name[1:2] == "(" and name.endswith(")") else name
    return inner + ")" * (inner.count("(") - inner.count(")"))  # ngspice writes v(net-(r1) for net-(r1)


def plot_in(folder: Path, plot: str, analysis: str) -> RawFile:
    """Return the raw file in a folder; raise InputError if it is missing or holds another plot.

    `plot`: expected name of the plot; `analysis`: name of the analysis in messages, such as "an operating point".
    """
    path = folder / RAW
    if not path.is_file():
        raise InputError("ngspice wrote no raw file")
    raw = read_rawfile(path.read_bytes(), "ngspice's raw file")
    if raw.plot != plot:
        raise InputError(f"ngspice computed {raw.plot!r} instead of {analysis}")
    return raw


def _operating_point(folder: Path) -> RawFile:
    """Return the raw file in a folder; raise InputError unless it is one operating point with voltages."""
    raw = plot_in(folder, _PLOT, "an operating point")
    if raw.values.shape[0] != 1 or np.iscomplexobj(raw.values):
        raise InputError(
            f"ngspice wrote {raw.values.shape[0]} points of type {raw.values.dtype}, not one point of real numbers"
        )
    if set(raw.kinds) <= {"current"}:
        raise InputError("ngspice found no node in the deck")
    return raw
