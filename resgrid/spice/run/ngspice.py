"""Running ngspice on a deck, and believing neither its exit status nor its silence."""

from __future__ import annotations

import contextlib
import math
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np

from resgrid._internal.files import temporary_folder
from resgrid.errors import BudgetError, InputError, ToolMissingError
from resgrid.spice.run.rawfile import RawFile, read_rawfile

if sys.platform == "linux":
    import resource

EXECUTABLE_VARIABLE = "RESGRID_NGSPICE"
_INSTALL = (
    "the circuit simulator {name} is not installed: 'sudo apt-get install ngspice' (Debian, Ubuntu), "
    f"'brew install ngspice' (macOS), or set {EXECUTABLE_VARIABLE} to the program"
)
_DECK, RAW, _LOG = "deck.cir", "operating_point.raw", "log.txt"
_RUN = '* operating point of {deck}\n.include "{deck}"\n.options klu\n.op\n.end\n'
_PLOT = "Operating Point"
_MAX_LOG = 2**20
_MAX_SECONDS = 2**31
_MAX_COMPLAINTS = 10
MAX_ASCENT = 8
"""How many ``..`` the name of an included file may hold: so deep lies the folder that such a deck is run in."""
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
# ngspice goes by how a word begins, drops carriage returns wherever they stand, and takes a file for a script whose
# title says so; its code models (elements A) open files and run programs.
_BOM = b"\xef\xbb\xbf"
_COMMANDS = rb"\*#|\*ng_script|\.(?:control|exec|csparam)\w*"
_FILES, _MODELS, _CODE_MODELS = rb"|\.(?:inc|lib)\w*", rb"|\.(?:model|func)\w*", rb"|(?<=\n)[ \t\v\f]*a\S*"
VERSIONS = ("39", "46")
"""Those that resgrid is tried with: Debian 12's own and that of its backports."""


@dataclass(frozen=True, eq=False)
class SimulatorRun:
    """What a simulator said.

    `voltage`: per node, in volts; empty if there is no operating point; `source_current`: into the plus terminal of
    every voltage source, in amperes; `simulator, version`: who was asked; ``"unknown"`` if it does not tell;
    `complaints`: what is wrong with the run, if only by its own messages; empty if it can be trusted.
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
    """Find the operating point of a deck's content, in a private folder; a deck at fault is no exception.

    ``source`` names it in messages; ``direct``: it asks for its analysis itself; ``files``: what it includes, by their
    places beside its own ``place``.  It may take ``timeout`` seconds.
    """
    program = find_program(EXECUTABLE_VARIABLE, "ngspice", _INSTALL)
    refuse_commands(data, source, models=direct, includes=bool(files))
    with temporary_folder() as folder:
        version = _version(program, folder)
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
    """Version of the installed ngspice, e.g. ``"39"``; ``"unknown"`` if it does not tell."""
    with temporary_folder() as folder:
        return _version(find_program(EXECUTABLE_VARIABLE, "ngspice", _INSTALL), folder)


def find_program(variable: str, name: str, remedy: str) -> str:
    """Absolute path of a program, which a variable of the environment may name."""
    named = os.environ.get(variable) or name
    path = shutil.which(named)
    if path is None:
        raise ToolMissingError(remedy.format(name=repr(named)))
    return str(Path(path).absolute())


def refuse_commands(data: bytes, source: str, *, models: bool = False, includes: bool = False) -> None:
    """Refuse a deck that could run commands or read other files."""
    words = _COMMANDS + (b"" if includes else _FILES) + (_CODE_MODELS if models else _MODELS)
    forbidden = re.compile(rb"^\s*(" + words + rb")", re.IGNORECASE | re.MULTILINE)
    data = data.removeprefix(_BOM)
    for text in (data.replace(b"\r", b"\n"), data.replace(b"\r", b"")) if b"\r" in data else (data,):
        match = forbidden.search(text)
        if match:
            line = text.count(b"\n", 0, match.start(1)) + 1
            word = match.group(1).decode("ascii", "replace").strip()
            raise InputError(
                f"{source}, line {line}: {word!r} is not simulated, for it could run commands or read other files; "
                "remove it"
            )


def _version(program: str, folder: Path) -> str:
    try:
        run_quietly([program, "--version"], folder, 10.0, "--version")
    except BudgetError:
        return "unknown"
    return version_in(folder)


def version_in(folder: Path) -> str:
    """Version of ngspice that the log in a folder tells of."""
    match = _VERSION.search(_read_log(folder))
    return match.group(1) if match else "unknown"


def run_quietly(
    command: list[str], folder: Path, timeout: float, source: str, name: str = "ngspice", cwd: Path | None = None
) -> int:
    """Run a simulator in a folder, its output in a log there; its exit status, of which nothing follows.

    With ``cwd`` it runs in another folder than that of the log.
    """
    environment = {key: value for key, value in os.environ.items() if not key.startswith(("SPICE", "NGSPICE"))}
    environment |= {"LC_ALL": "C"}
    if name == "ngspice":
        environment |= {"OMP_NUM_THREADS": "1"}  # so that its processor time is at most the time that passes
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
            raise ToolMissingError(f"cannot run {command[0]}: {error.strerror}; install {name} anew") from error
        _limit_processor_time(process.pid, timeout * (1 if name == "ngspice" else os.cpu_count() or 1))
        try:
            return process.wait(timeout)
        except subprocess.TimeoutExpired as error:
            raise BudgetError(
                f"{name} did not finish {source} within {timeout:g} s; allow more time or check a smaller grid"
            ) from error
        finally:  # a time-out and Ctrl-C alike leave no process behind
            if process.poll() is None:
                if hasattr(os, "killpg"):  # with all that it started
                    os.killpg(process.pid, signal.SIGKILL)
                else:  # Windows
                    process.kill()
                process.wait()


def _limit_processor_time(pid: int, seconds: float) -> None:
    """Let the system end a process that computes longer, for a killed parent cannot; on Linux only."""
    if sys.platform != "linux":
        return
    limit = min(math.ceil(seconds) + 1, _MAX_SECONDS)
    with contextlib.suppress(OSError, ValueError):  # it has ended, or a lower limit holds
        resource.prlimit(pid, resource.RLIMIT_CPU, (limit, limit))


def _read_log(folder: Path) -> str:
    with (folder / _LOG).open("rb") as log:
        return log.read(_MAX_LOG).decode("utf-8", "replace")


def result_in(folder: Path, simulator: str, version: str, status: int) -> SimulatorRun:
    """What a simulator left in a folder: its raw file, and what it complains about in its log."""
    lines = (re.sub(r"\s+", " ", line).strip() for line in re.split(r"[\r\n]+", _read_log(folder)))
    bad = dict.fromkeys(line for line in lines if _COMPLAINT.search(line) and not _HARMLESS.search(line))
    complaints = tuple(f"{simulator} says: {line[:200]}" for line in list(bad)[:_MAX_COMPLAINTS])
    try:
        raw = _operating_point(folder / RAW)
    except InputError as error:
        return SimulatorRun({}, {}, simulator, version, (f"{error} (exit status {status})", *complaints))
    read: dict[str, dict[str, float]] = {"voltage": {}, "current": {}}
    for name, kind, value in zip(raw.names, raw.kinds, raw.values[0].tolist(), strict=True):
        if kind in read:  # n_0_0 from v(n_0_0), v_obstacle from i(v_obstacle) or v_obstacle#branch
            inner = name[2:-1] if name[1:2] == "(" and name.endswith(")") else name
            inner += ")" * (inner.count("(") - inner.count(")"))  # v(net-(r1) is what it writes for net-(r1)
            read[kind][inner.removesuffix("#branch")] = value
    return SimulatorRun(read["voltage"], read["current"], simulator, version, complaints)


def _operating_point(path: Path) -> RawFile:
    """The raw file of an operating point."""
    if not path.is_file():
        raise InputError("ngspice left no raw file")
    raw = read_rawfile(path.read_bytes(), "ngspice's raw file")
    if raw.plot != _PLOT:
        raise InputError(f"ngspice computed {raw.plot!r} instead of an operating point")
    if raw.values.shape[0] != 1 or np.iscomplexobj(raw.values):
        raise InputError(
            f"ngspice left {raw.values.shape[0]} points of kind {raw.values.dtype}, not one of real numbers"
        )
    if "voltage" not in raw.kinds:
        raise InputError("ngspice found no node in the deck")
    return raw
