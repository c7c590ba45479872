"""Available simulators, each with its fastest linear solver."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path
from typing import NamedTuple

UNPACKED = Path(__file__).resolve().parents[1] / ".venv-bench" / "ngspice" / "usr" / "bin" / "ngspice"
"""Folder in which ``make bench`` unpacks the newest version of the system's backports."""


class Simulator(NamedTuple):
    """An ngspice: its `name` with version and solver, the `program`, and the `cards` that choose the solver."""

    name: str
    program: str
    cards: str

    def with_cards(self, deck: str) -> str:
        """Return the deck with the cards inserted before its end."""
        return deck.replace("\n.end", f"\n{self.cards}.end")


def simulators() -> list[Simulator]:
    """Return the simulator on PATH (or of `RESGRID_NGSPICE`) and the unpacked one; the best one is last."""
    there = [shutil.which(os.environ.get("RESGRID_NGSPICE", "ngspice")), UNPACKED if UNPACKED.exists() else None]
    found = {entry.name: entry for entry in map(_simulator, (str(program) for program in there if program))}
    return sorted(found.values(), key=lambda entry: ("KLU" in entry.name, entry.name))


def _simulator(program: str) -> Simulator:
    said = subprocess.run([program, "--version"], capture_output=True, text=True, check=False).stdout
    version = re.search(r"ngspice-(\d+)", said)
    klu = "KLU" in said
    name = f"ngspice {version[1] if version else '?'}, {'KLU' if klu else 'Sparse 1.3'}"
    return Simulator(name, program, ".options klu\n" if klu else "")
