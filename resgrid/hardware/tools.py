"""Search for the outside programs that verify boards and layouts: kicad-cli, and a Python with klayout.

Both are separate processes.  KLayout is licensed under the GPL, so resgrid never imports it.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path

from resgrid._internal.files import temporary_folder
from resgrid._internal.subprocesses import kill_session
from resgrid.errors import BudgetError, InputError, ToolMissingError

KICAD_VARIABLE = "RESGRID_KICAD_CLI"
"""Name of the environment variable that gives the path of kicad-cli."""

KLAYOUT_VARIABLE = "RESGRID_KLAYOUT_PYTHON"
"""Name of the environment variable that gives the path of a Python interpreter that can import ``klayout.db``."""

KICAD_VERSION = 9
"""Lowest major version of KiCad that reads the boards of resgrid."""

TIMEOUT = 600.0
"""Default limit of the duration of one run of an outside program, in seconds."""

_CHECKOUT = Path(__file__).resolve().parents[2]
_UNPACKED = _CHECKOUT / ".venv-kicad" / "kicad-cli"
"""Place of kicad-cli after ``scripts/unpack_kicad.sh .venv-kicad`` in a checkout of resgrid."""

_ASK_KLAYOUT = "import klayout.db; print(klayout.db.__version__)"
_SHOWN = 400
"""Maximum number of characters at the end of a program's output that an error message quotes."""


@dataclass(frozen=True)
class KicadCli:
    """An installed kicad-cli; `program`: path of the program; `version`: its version, such as ``"9.0.8"``."""

    program: str
    version: str

    def run(self, *arguments: str | Path, timeout: float = TIMEOUT) -> str:
        """Run kicad-cli, and return the text that it prints on standard output.

        `arguments`: arguments of the command; `timeout`: longest run, in seconds. KiCad's settings of the user have no
        effect. Raises InputError if kicad-cli fails, and BudgetError after the timeout.
        """
        with temporary_folder() as folder:
            settings = {"KICAD_CONFIG_HOME": str(folder), "LC_ALL": "C.UTF-8"}
            status, printed, messages = _run([self.program, *map(str, arguments)], timeout, settings)
        if status != 0:
            command = " ".join(takewhile(str.isalnum, map(str, arguments)))
            raise InputError(f"'kicad-cli {command}' failed for {arguments[-1]}: {_last(messages or printed)}")
        return printed


@dataclass(frozen=True)
class KlayoutPython:
    """A Python interpreter with klayout; `program`: path of the interpreter; `version`: version of klayout."""

    program: str
    version: str

    def run(self, script: Path, *arguments: str | Path, timeout: float = TIMEOUT) -> str:
        """Run a Python script, and return the text that it prints on standard output.

        `script`: path of the script; `arguments`: its arguments; `timeout`: longest run, in seconds. Raises InputError
        if the script fails, and BudgetError after the timeout.
        """
        status, printed, messages = _run([self.program, "-I", str(script), *map(str, arguments)], timeout, {})
        if status != 0:
            raise InputError(f"klayout cannot extract {' '.join(map(str, arguments[:1]))}: {_last(messages)}")
        return printed


def find_kicad() -> KicadCli:
    """Return the installed kicad-cli.

    Candidates are the program that ``RESGRID_KICAD_CLI`` names, and otherwise ``kicad-cli`` on PATH and the program
    that ``scripts/unpack_kicad.sh .venv-kicad`` has unpacked into the checkout.  Raises ToolMissingError if none of
    them is KiCad 9 or newer.
    """
    named = os.environ.get(KICAD_VARIABLE)
    found = []
    for program in [named] if named else ["kicad-cli", str(_UNPACKED)]:
        path = shutil.which(program)
        version = _version([path, "version"]) if path else ""
        if path and _major(version) >= KICAD_VERSION:
            return KicadCli(path, version)
        found += [f"{path} has version {version or 'unknown'}"] if path else []
    state = f"{KICAD_VARIABLE} = {named} is not a program" if named else "kicad-cli is not installed"
    raise ToolMissingError(f"{found[0] + f', and {KICAD_VERSION} is needed' if found else state}: {kicad_remedy()}")


def kicad_remedy() -> str:
    """Return a sentence about the ways to obtain kicad-cli, for messages."""
    script = f"'scripts/unpack_kicad.sh .venv-kicad' in {_CHECKOUT} unpacks it on Debian 12 without root; otherwise "
    has_script = (_CHECKOUT / "scripts" / "unpack_kicad.sh").exists()
    return (
        f"{script if has_script else ''}install KiCad {KICAD_VERSION} (https://www.kicad.org/download), "
        f"or set {KICAD_VARIABLE} to the program"
    )


def find_klayout() -> KlayoutPython:
    """Return a Python interpreter with klayout: that of ``RESGRID_KLAYOUT_PYTHON``, or else the running interpreter.

    Raises ToolMissingError if the interpreter cannot import ``klayout.db``.
    """
    named = os.environ.get(KLAYOUT_VARIABLE)
    program = shutil.which(named or sys.executable)
    version = _version([program, "-I", "-c", _ASK_KLAYOUT]) if program else ""
    if program and version:
        return KlayoutPython(program, version)
    state = f"{KLAYOUT_VARIABLE} = {named} is not a Python with klayout" if named else "klayout is not installed"
    raise ToolMissingError(
        f"{state}: '{sys.executable or 'python'} -m pip install klayout', "
        f"or set {KLAYOUT_VARIABLE} to a Python interpreter that can import klayout.db"
    )


def _version(command: list[str]) -> str:
    """Return the version that a program prints; empty if the program fails or prints no version.

    `command`: program and arguments.
    """
    with temporary_folder() as folder:
        try:
            status, printed, _ = _run(command, 60.0, {"KICAD_CONFIG_HOME": str(folder)})
        except (ToolMissingError, BudgetError):
            return ""
    match = re.search(r"\d+(\.\d+)+\S*", printed) if status == 0 else None
    return match.group() if match else ""


def _major(version: str) -> int:
    """Return the first number of a version text such as "9.0.8", 0 without a number."""
    numbers = re.findall(r"\d+", version)
    return int(numbers[0]) if numbers else 0


def _last(messages: str) -> str:
    """Return the end of a program's output on one line, at most `_SHOWN` characters."""
    return " ".join(messages.split())[-_SHOWN:] or "it printed no message"


def _run(command: list[str], timeout: float, settings: Mapping[str, str]) -> tuple[int, str, str]:
    """Run a program; return its exit status and the texts that it prints on stdout and stderr.

    `command`: program and arguments; `timeout`: longest run, in seconds; `settings`: additional environment variables.
    """
    try:
        process = subprocess.Popen(
            command,
            env={**os.environ, **settings},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            encoding="utf-8",
            errors="replace",
            start_new_session=True,
        )
    except OSError as error:
        raise ToolMissingError(f"cannot run {command[0]}: {error.strerror}; reinstall it") from error
    with process:
        try:
            printed, messages = process.communicate(timeout=timeout)
        except subprocess.TimeoutExpired as error:
            name = Path(command[0]).name
            raise BudgetError(
                f"{name} did not finish within {timeout:g} s; allow more time, or check a smaller file"
            ) from error
        finally:  # after a timeout and after Ctrl-C
            kill_session(process)
    return process.returncode, printed, messages
