"""Reader of chip processes from the data files of this package: one file per process, listed in `FILES`."""

from __future__ import annotations

import tomllib
from functools import cache
from pathlib import Path
from typing import Any

from resgrid.errors import InputError, suggestion
from resgrid.processes.process import Process

FILES = {
    "ihp-sg13g2": "ihp_sg13g2.toml",
    "toy": "toy.toml",
}
"""Data file of every process, by the name of the process."""


def process_names() -> list[str]:
    """Return one name for every resistor of every process, such as ``"ihp-sg13g2:rppd"``.

    Examples
    --------
    >>> rg.processes.process_names()
    ['ihp-sg13g2:rhigh', 'ihp-sg13g2:rppd', 'toy:poly']
    """
    return sorted(f"{name}:{resistor}" for name in FILES for resistor in _table(name)["resistors"])


@cache
def read_process(name: str) -> Process:
    """Return a process by its name and the name of one of its resistors.

    Parameters
    ----------
    name : str
        Name such as ``"ihp-sg13g2:rppd"``; `process_names` lists them.

    Returns
    -------
    Process
        Design rules and electrical figures of the process.

    Raises
    ------
    InputError
        If there is no such process or resistor.

    Examples
    --------
    >>> rg.processes.read_process("ihp-sg13g2:rppd").resistor.sheet_resistance
    260.0
    """
    known = process_names()
    if name not in known:
        nearby = suggestion(name, known)
        hint = f"{nearby}; " if nearby else ""
        raise InputError(f"process = {name!r} is unknown; {hint}there are {', '.join(known)}")
    from pydantic import TypeAdapter

    return TypeAdapter(Process).validate_python({"name": name, **_table(name.partition(":")[0])})


@cache
def _table(name: str) -> dict[str, Any]:
    """Return the parsed data file of a process; `name`: name of the process, without a resistor."""
    return tomllib.loads((Path(__file__).parent / FILES[name]).read_text(encoding="utf-8"))
