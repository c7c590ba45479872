"""Section: time of the first command and of the first solution, each in a separate process."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from functools import partial

from benchmarks.rows import Row, Scale, Spread
from benchmarks.timing import alternating, spread

LIGHT = {
    "import resgrid, above Python's own start": "import resgrid",
    "resgrid --help, above Python's own start": "from resgrid.cli import main; main(['--help'], prog_name='resgrid')",
}
FIRST = """
import time
from benchmarks.ours import Resgrid
from benchmarks.problems import Problem
job = Resgrid(Problem({kind!r}, {size}, "dirichlet", {seed}, width=3))
start = time.perf_counter()
answer = job.run({accuracy!r}, 1e-8)
print(time.perf_counter() - start, answer.method)
"""


def start(scale: Scale) -> list[Row]:
    """Section: start the command line; compile the kernels of the first solutions into an empty cache."""
    rows = [_light_row(name, code, scale) for name, code in LIGHT.items()]
    plane, maze = {"tiny": (40, 24)}.get(scale.name, (512, 256))
    first = (("rectangles", plane, "normwise"), ("rectangles", plane, "direction"), ("maze", maze, "direction"))
    return rows + [_first_row(kind, size, accuracy, scale) for kind, size, accuracy in first]


def _light_row(name: str, code: str, scale: Scale) -> Row:
    ours, python = (partial(_python, words) for words in (code, "pass"))
    seconds, bare, _ = alternating(ours, python, scale.rounds)
    above = Spread(seconds.median - bare.median, seconds.low - bare.median, seconds.high - bare.median)
    return Row(name, seconds.median, above, "s")


def _first_row(kind: str, size: int, accuracy: str, scale: Scale) -> Row:
    """Solve once with an empty kernel cache."""
    with tempfile.TemporaryDirectory(prefix="resgrid-bench-") as cache:
        code = FIRST.format(kind=kind, size=size, seed=scale.seed + size, accuracy=accuracy)
        seconds, method = _python(code, NUMBA_CACHE_DIR=cache).split()
    name = f"first solution, {kind} {size}^2, {accuracy}"
    return Row(name, float(seconds), spread([float(seconds)]), "s", note=f"{method}, kernels compiled")


def _python(code: str, **environment: str) -> str:
    """Return the output of a new Python process."""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env={**os.environ, **environment}
    )
    return done.stdout
