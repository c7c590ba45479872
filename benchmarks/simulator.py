"""Section: complete run of ngspice on a deck relative to resgrid on the same circuit."""

from __future__ import annotations

import subprocess
import tempfile
from functools import partial
from pathlib import Path

from benchmarks.problems import Problem
from benchmarks.rows import RATIO, Row, Scale
from benchmarks.simulators import Simulator, simulators
from benchmarks.timing import busy, spread
from resgrid.circuit.solve import solve
from resgrid.spice.write.flat import flatten

LARGE = 200
"""Cells per side from which ngspice runs only once."""


def simulator(scale: Scale) -> list[Row]:
    """Section: read, factor, solve and write by ngspice in batch mode; read and solve (normwise) by resgrid."""
    sizes = {"tiny": (12,), "quick": (128,), "full": (128, 256)}[scale.name]
    found = simulators()
    if not found:
        return [Row("ngspice", None, None, RATIO, "ngspice", "ngspice is not installed")]
    problems = [Problem("rectangles", n, b, scale.seed + n) for n in sizes for b in ("dirichlet", "neumann")]
    return [_row(problem, theirs, scale) for problem in problems for theirs in found]


def _row(problem: Problem, simulator: Simulator, scale: Scale) -> Row:
    netlist = problem.netlist()
    ours = partial(solve, netlist, accuracy="normwise", rtol=1e-8)
    ours()
    with tempfile.TemporaryDirectory(prefix="resgrid-bench-") as name:
        folder = Path(name)
        deck = flatten(netlist).text.replace("\n.end", "\n.op\n.end")
        (folder / "deck.cir").write_text(simulator.with_cards(deck))
        theirs = partial(_run, simulator.program, folder, 60 * scale.limit)
        rounds = 1 if problem.size >= LARGE and not simulator.cards else min(scale.rounds, 3)
        pairs = [(busy(theirs), spread([busy(ours) for _ in range(3)]).median) for _ in range(rounds)]
    ratios = spread([theirs / ours for theirs, ours in pairs])
    seconds = spread([theirs for theirs, _ in pairs]).median
    note = f"resgrid {1e3 * pairs[-1][1]:.1f} ms, {rounds} runs"
    return Row(f"{problem.name}: whole run of {simulator.name}", seconds, ratios, RATIO, simulator.name, note)


def _run(program: str, folder: Path, limit: float) -> None:
    """Run ngspice once in batch mode, with the operating point in a raw file."""
    command = [program, "-n", "-b", "-r", "point.raw", "deck.cir"]
    subprocess.run(command, cwd=folder, capture_output=True, timeout=limit, check=False)
    if not (folder / "point.raw").exists():
        raise RuntimeError("ngspice wrote no operating point")
    (folder / "point.raw").unlink()
