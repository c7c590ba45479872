"""Writing a deck: the portable file, its commands for the simulator, and its sidecar."""

from __future__ import annotations

import hashlib
import os
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from resgrid.errors import InputError
from resgrid.files import atomic_path
from resgrid.netlist import Netlist
from resgrid.nodal.operating_point import OperatingPoint
from resgrid.spice.deck import flatten
from resgrid.spice.expected import expect
from resgrid.spice.sidecar import format_sidecar, sidecar_path


@dataclass(frozen=True)
class WrittenDeck:
    """The files of one deck.

    Attributes
    ----------
    path : Path
        The portable deck, without commands.
    commands : Path
        The file that includes it and asks the simulator for its operating point.
    sidecar : Path
        Hash, cells, expected voltages and versions, as JSON.
    sha256 : str
        Hash of the deck.
    """

    path: Path
    commands: Path
    sidecar: Path
    sha256: str


def write_spice(
    netlist: Netlist,
    path: str | os.PathLike[str],
    dialect: str = "ngspice",
    *,
    title: str | None = None,
    operating_point: OperatingPoint | None = None,
) -> WrittenDeck:
    """Write a flat deck, the simulator's commands and the sidecar.

    Parameters
    ----------
    netlist : Netlist
    path : path-like
        The deck; ``PATH.json`` and ``PATH.ngspice`` (the dialect's name) are written beside it.
    dialect : str
        One of `resgrid.spice.dialects.DIALECTS`.
    title : str, optional
        First line of the deck.
    operating_point : OperatingPoint, optional
        Where the expected voltages come from; without it the netlist is solved.

    Returns
    -------
    WrittenDeck

    Raises
    ------
    InputError
        If the dialect is unknown, a file cannot be written or the operating point belongs to another netlist.
    CircuitError
        If the netlist has no operating point.
    """
    target = Path(path)
    if target.exists() and not (target.is_file() or target.is_dir()):
        raise InputError(f"cannot write a deck to {target}: its sidecar needs a place beside it; name a file")
    if '"' in target.name or not target.name.isprintable():
        raise InputError(f"cannot write a deck to {str(target)!r}: simulators cannot include a file of that name")
    deck = flatten(netlist, dialect=dialect, title=title)
    expected = expect(deck, _solution(netlist) if operating_point is None else operating_point)
    contents = {
        target.with_name(f"{target.name}.{deck.dialect.name}"): deck.dialect.commands.format(deck=target.name),
        sidecar_path(target): format_sidecar(target.name, deck, expected),
        target: deck.text,
    }
    with ExitStack() as stack:
        for file, text in reversed(contents.items()):
            stack.enter_context(atomic_path(file)).write_bytes(text.encode("utf-8"))
    commands, sidecar, _ = contents
    return WrittenDeck(target, commands, sidecar, hashlib.sha256(deck.text.encode("ascii")).hexdigest())


def _solution(netlist: Netlist) -> OperatingPoint:
    from resgrid.nodal.solve import solve

    return solve(netlist)
