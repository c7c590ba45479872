"""Installation commands for the optional packages (extras) of resgrid."""

from __future__ import annotations

import re
import shlex
import sys
from importlib import metadata
from pathlib import Path

_ENTRY = re.compile(r"""(?P<package>[^;]+?)\s*;.*\bextra\s*==\s*['"](?P<extra>[\w-]+)['"]""")
"""Pattern of a requirement of an extra in the metadata of a distribution, such as ``mpi4py>=4; extra == 'mpi'``."""


def install_command(extra: str) -> str:
    """Return the shell command that installs the packages of an extra of resgrid; `extra`: name, such as ``"mpi"``.

    The command lists the packages of the extra, so that it works for a checkout, a wheel and an index, and without an
    activated environment.
    """
    try:
        entries = filter(None, map(_ENTRY.match, metadata.requires("resgrid") or ()))
        packages = [entry["package"] for entry in entries if entry["extra"] == extra]
    except metadata.PackageNotFoundError:  # imported from a checkout that is not installed
        packages = [f"{Path(__file__).parents[2]}[{extra}]"]
    return shlex.join([sys.executable or "python", "-m", "pip", "install", *packages])
