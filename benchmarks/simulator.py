"""Section: ngspice's whole run on a deck against resgrid's on the same circuit."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from functools import partial
from pathlib import Path

from benchmarks.problems import Problem
from benchmarks.rows import RATIO, Row, Scale
from benchmarks.timing import spread, timed
from resgrid.circuit.solve import solve
from resgrid.spice.write.flat import flatten

LARGE = 200
"""Cells a side from which ngspice runs once only."""


def simulator(scale: Scale) -> list[Row]:
    """Read, factor, solve and write by ngspice in batch mode; read a netlist and solve it, normwise, by resgrid."""
    sizes = {"tiny": (12,), "quick": (128,), "full": (128, 256)}[scale.name]
    program = shutil.which(os.environ.get("RESGRID_NGSPICE", "ngspice"))
    if program is None:
        return [Row("ngspice", None, None, RATIO, "ngspice", "ngspice is not installed")]
    problems = [Problem("rectangles", n, b, scale.seed + n) for n in sizes for b in ("dirichlet", "neumann")]
    return [_row(problem, program, scale) for problem in problems]


def _row(problem: Problem, program: str, scale: Scale) -> Row:
    netlist = problem.netlist()
    ours = partial(solve, netlist, accuracy="normwise", rtol=1e-8)
    ours()
    with tempfile.TemporaryDirectory(prefix="resgrid-bench-") as name:
        folder = Path(name)
        (folder / "deck.cir").write_text(flatten(netlist).text.replace("\n.end", "\n.op\n.end"))
        theirs = partial(_run, program, folder, 60 * scale.limit)
        rounds = 1 if problem.size >= LARGE else min(scale.rounds, 3)
        pairs = [(timed(theirs), spread([timed(ours) for _ in range(3)]).median) for _ in range(rounds)]
    ratios = spread([theirs / ours for theirs, ours in pairs])
    seconds = spread([theirs for theirs, _ in pairs]).median
    note = f"resgrid {1e3 * pairs[-1][1]:.1f} ms, {rounds} runs"
    return Row(f"{problem.name}: ngspice's whole run", seconds, ratios, RATIO, "ngspice", note)


def _run(program: str, folder: Path, limit: float) -> None:
    """One batch run, its operating point in a raw file."""
    command = [program, "-n", "-b", "-r", "point.raw", "deck.cir"]
    subprocess.run(command, cwd=folder, capture_output=True, timeout=limit, check=False)
    if not (folder / "point.raw").exists():
        raise RuntimeError("ngspice wrote no operating point")
    (folder / "point.raw").unlink()
