"""Section: time to read, solve and write decks, relative to Python's SPICE parsers, ngspice and plain text output.

The deck is a power grid in which every resistance is different.  Every ratio is taken within a round.
"""

from __future__ import annotations

import logging
import subprocess
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.rows import RATIO, Row, Scale
from benchmarks.simulators import simulators
from benchmarks.timing import alternating, spread, timed
from resgrid.circuit.solve import solve
from resgrid.core.netlist import Netlist
from resgrid.spice.read.deck import read_spice
from resgrid.spice.write.flat import flatten, resistances

SIDES = {"tiny": (16, 16), "quick": (256, 128), "full": (256, 256)}
"""Nodes per side of the deck for reading and writing, and of the deck for ngspice."""

PAD, LOADED = 32, 0.1
"""Cells between two pads, and fraction of nodes with a load current."""


def decks(scale: Scale) -> list[Row]:
    """Compare reading with spicelib, InSpice and PySpice, reading and solving with ngspice, and writing with repr."""
    side, simulated = SIDES[scale.name]
    netlist = power_grid(side, scale.seed)
    what = f"{side}^2 deck, {len(netlist.conductance):,} resistors"
    with tempfile.TemporaryDirectory(prefix="resgrid-bench-") as name:
        path, other = Path(name) / "grid.cir", Path(name) / "simulated.cir"
        for file, circuit in ((path, netlist), (other, power_grid(simulated, scale.seed))):
            file.write_text(flatten(circuit).text.replace("\n.end", "\n.op\n.end"))
            read_spice(file)
        rows = [_reading(what, path, parser, scale) for parser in PARSERS]
        return [*rows, _solving(f"{simulated}^2 deck", other, scale), _writing(what, netlist, path, scale)]


def power_grid(side: int, seed: int) -> Netlist:
    """Return a square of different resistors, pads of 1.8 V behind 10 milliohm, and loads at a tenth of the nodes."""
    rng = np.random.default_rng(seed)
    node = 1 + np.arange(side * side).reshape(side, side)
    pads = node[PAD // 4 :: PAD, PAD // 4 :: PAD].ravel()
    supply = node.size + 1 + np.arange(len(pads))
    across = np.stack([node[:, :-1].ravel(), node[:, 1:].ravel()], axis=1)
    down = np.stack([node[:-1].ravel(), node[1:].ravel()], axis=1)
    pairs = np.concatenate([down, across, np.stack([supply, pads], axis=1)])
    ohms = np.concatenate([rng.uniform(0.5, 2.0, len(pairs) - len(pads)), np.full(len(pads), 0.01)])
    loaded = rng.choice(node.ravel(), int(LOADED * node.size), replace=False)
    return Netlist(
        int(supply[-1]) + 1,
        pairs,
        1 / ohms,
        source_nodes=np.stack([supply, np.zeros_like(supply)], axis=1),
        source_volts=np.full(len(supply), 1.8),
        current_nodes=np.stack([loaded, np.zeros_like(loaded)], axis=1),
        current_amps=rng.uniform(0.0, 1e-4, len(loaded)),
    )


def _spicelib() -> Callable[[Path], object]:
    from spicelib import SpiceEditor

    return lambda path: SpiceEditor(str(path))


def _inspice() -> Callable[[Path], object]:
    from InSpice.Spice.Parser import SpiceFile

    return lambda path: SpiceFile(path=str(path))


def _pyspice() -> Callable[[Path], object]:
    from PySpice.Spice.Parser import SpiceParser

    return lambda path: SpiceParser(path=str(path))


PARSERS = {"spicelib": _spicelib, "InSpice": _inspice, "PySpice": _pyspice}
"""Return the reading functions of the other parsers; report missing ones."""


def _reading(what: str, path: Path, parser: str, scale: Scale) -> Row:
    name = f"read a {what}"
    try:
        read = PARSERS[parser]()
    except ImportError:
        return Row(name, None, None, RATIO, parser, "not installed")
    logging.disable(logging.CRITICAL)
    try:
        theirs, ours, ratio = alternating(partial(read, path), partial(read_spice, path), min(scale.rounds, 3))
    except Exception as error:
        return Row(name, None, None, RATIO, parser, f"cannot read it: {type(error).__name__}: {str(error)[:60]}")
    finally:
        logging.disable(logging.NOTSET)
    return Row(name, theirs.median, ratio, RATIO, parser, f"resgrid {ours.median:.3f} s")


def _solving(what: str, path: Path, scale: Scale) -> Row:
    name = f"read and solve a {what}"
    found = simulators()
    if not found:
        return Row(name, None, None, RATIO, "ngspice", "not installed")

    best = found[-1]
    deck = path.with_name(f"simulated_{path.name}")
    deck.write_text(best.with_cards(path.read_text()))

    def ours() -> None:
        solve(read_spice(path).netlist())

    def theirs() -> None:
        words = [best.program, "-n", "-b", "-r", "point.raw", deck.name]
        subprocess.run(words, cwd=path.parent, capture_output=True, timeout=60 * scale.limit, check=False)

    ours()
    rounds = 1 if scale.full else min(scale.rounds, 3)
    pairs = [(timed(theirs), timed(ours)) for _ in range(rounds)]
    note = f"resgrid {spread([own for _, own in pairs]).median:.3f} s, {rounds} runs"
    ratio = spread([other / own for other, own in pairs])
    return Row(name, spread([other for other, _ in pairs]).median, ratio, RATIO, best.name, note)


def _writing(what: str, netlist: Netlist, path: Path, scale: Scale) -> Row:
    """Compare writing the deck with writing only its resistances, formatted by repr, joined and written once."""
    values = resistances(netlist.conductance).tolist()
    target = path.with_name("written.cir")

    def ours() -> None:
        target.write_bytes(flatten(netlist).text.encode("ascii"))

    def bare() -> None:
        target.write_text("\n".join(map(repr, values)))

    ours()
    seconds, plain, ratio = alternating(ours, bare, scale.rounds)
    return Row(f"write a {what}", seconds.median, ratio, "x repr", "resgrid", f"repr joined {plain.median:.3f} s")
