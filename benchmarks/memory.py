"""Section: memory of a solution in addition to its netlist, measured in a child process.

The child builds the netlist, trims the heap, resets the kernel's peak record (``/proc/self/clear_refs``), solves, and
reads the peak resident set, which includes arrays of compiled code.  A second child repeats the solution under
`tracemalloc`, which counts all numpy arrays, but only these.
"""

from __future__ import annotations

import ctypes
import gc
import json
import os
import subprocess
import sys
import tracemalloc
from dataclasses import asdict
from pathlib import Path

from benchmarks.comparison import RTOL
from benchmarks.contest import ONE_THREAD, ROOT
from benchmarks.problems import Problem, equations
from benchmarks.rows import Row, Scale, Spread

TRIALS = 3


def memory(scale: Scale) -> list[Row]:
    """Section: peak memory of a normwise solution in addition to the netlist, in bytes per unknown."""
    if not Path("/proc/self/clear_refs").exists():
        return [Row("memory above the netlist", None, None, "bytes/unknown", note="needs Linux's /proc")]
    flat, deep = {"tiny": (32, 8), "quick": (1024, 64), "full": (2048, 128)}[scale.name]
    problems = [
        Problem(kind, size, boundary, scale.seed + size)
        for kind, size in (("rectangles", flat), ("boxes", deep))
        for boundary in ("dirichlet", "neumann")
    ]
    return [_row(problem, scale, how) for problem in problems for how in ("resident", "tracemalloc")]


def _row(problem: Problem, scale: Scale, how: str) -> Row:
    name = f"{problem.name}: memory, {how}"
    found = []
    for _ in range(TRIALS if how == "resident" else 1):
        try:
            done = subprocess.run(
                [sys.executable, "-m", "benchmarks.memory", how, json.dumps(asdict(problem))],
                capture_output=True,
                text=True,
                timeout=4 * scale.limit,
                cwd=ROOT,
                env={**os.environ, **ONE_THREAD},
                check=False,
            )
        except subprocess.TimeoutExpired as error:
            return Row(name, None, None, "bytes/unknown", note=f"not done after {error.timeout:g} s")
        if done.returncode:
            note = done.stderr.strip().splitlines()[-1] if done.stderr.strip() else f"status {done.returncode}"
            return Row(name, None, None, "bytes/unknown", note=note)
        found.append(json.loads(done.stdout))
    each = sorted(reply["bytes"] / reply["unknowns"] for reply in found)
    value = Spread(each[len(each) // 2], each[0], each[-1])
    return Row(name, None, value, "bytes/unknown", note=found[-1]["method"])


def measure(how: str, problem: Problem) -> dict[str, object]:
    """Solve once in this process; return the increase of memory at the peak in bytes."""
    from resgrid.circuit.solve import solve

    small = Problem(problem.kind, 40 if problem.kind == "rectangles" else 12, problem.boundary)
    solve(small.netlist(), accuracy="normwise", method=_method(problem), rtol=RTOL)
    netlist = problem.netlist()
    unknowns = len(equations(netlist).rhs)
    gc.collect()
    if how == "tracemalloc":
        tracemalloc.start()
        method = solve(netlist, accuracy="normwise", rtol=RTOL).method
        return {"bytes": tracemalloc.get_traced_memory()[1], "unknowns": unknowns, "method": method}
    ctypes.CDLL(None).malloc_trim(0)
    Path("/proc/self/clear_refs").write_text("5")
    before = _status("VmRSS")
    method = solve(netlist, accuracy="normwise", rtol=RTOL).method
    return {"bytes": _status("VmHWM") - before, "unknowns": unknowns, "method": method}


def _method(problem: Problem) -> str:
    """Return the method chosen for a problem of this size; its kernels must be compiled before the measurement."""
    from resgrid.circuit.equations import assemble
    from resgrid.solvers.method_choice import choose_method

    return choose_method(assemble(problem.netlist()).laplacian).method


def _status(key: str) -> int:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(f"{key}:"):
            return int(line.split()[1]) * 1024
    raise ValueError(f"/proc/self/status has no {key}")


if __name__ == "__main__":
    sys.stdout.write(json.dumps(measure(sys.argv[1], Problem(**json.loads(sys.argv[2])))) + "\n")
