"""Loops that are kept on disk."""

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import resgrid

_SUM = """
import numpy as np
from resgrid.circuit.kernels import add_flows
net = np.zeros((3, 2))
add_flows(np.array([[0, 1]], dtype=np.int32), np.ones(1), np.ones(1), np.zeros(1), *net)
print(net[0, 1])
"""

_GRAPH = """
import sys
import numpy as np
from resgrid.solvers import laplacian
from resgrid.solvers.multigrid.graph_coarsening import sum_up
rows = np.array([0, 1, 2], dtype=np.int32), np.array([1, 0], dtype=np.int32)
graph = getattr(laplacian, sys.argv[1])(*rows, np.ones(2), np.ones(2))
print(sum_up(graph, np.zeros(2, dtype=np.int32), 1)[3][0])
"""

_INTERRUPTED = """
import random, signal, time
import numpy as np
import resgrid as rg

def interrupt(number, frame):
    raise KeyboardInterrupt

cell = np.zeros((40, 40), dtype=np.uint8)
cell[20, 20] = 2
netlist = rg.compile_space(rg.ConfigurationSpace([rg.Axis(name, 0.0, 1.0, 40) for name in "xy"], cell))
rg.solve(netlist)
start = time.perf_counter()
voltage = rg.solve(netlist).voltage
longest, caught = time.perf_counter() - start, 0
signal.signal(signal.SIGALRM, interrupt)
draw = random.Random(0)
while caught < 200:
    start = time.perf_counter()
    try:
        signal.setitimer(signal.ITIMER_REAL, draw.uniform(1e-5, longest))
        rg.solve(netlist)
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        longest = min(longest, time.perf_counter() - start)
    except KeyboardInterrupt:
        caught += 1
assert np.array_equal(rg.solve(netlist).voltage, voltage)
"""


@pytest.mark.skipif(not hasattr(signal, "SIGALRM"), reason="the system knows no alarms")
def test_an_interrupt_at_any_moment_of_a_solve_is_one() -> None:
    """While numba makes a named tuple of what a loop returns it ended Python; of arrays it was a `SystemError`."""
    run = subprocess.run([sys.executable, "-c", _INTERRUPTED], capture_output=True, text=True, timeout=300, check=False)
    assert run.returncode == 0, run.stderr


def test_a_loop_is_compiled_anew_when_one_that_it_calls_has_changed_in_another_file(tmp_path: Path) -> None:
    package = tmp_path / "resgrid"
    shutil.copytree(Path(resgrid.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__"))
    environment = os.environ | {"PYTHONPATH": str(tmp_path), "NUMBA_CACHE_DIR": str(tmp_path / "kept")}

    def told() -> float:
        run = subprocess.run(
            [sys.executable, "-c", _SUM], env=environment, cwd=tmp_path, capture_output=True, text=True, check=True
        )
        return float(run.stdout)

    assert told() == told() == 1.0
    called = package / "solvers" / "scaled_kernels.py"
    source, head = called.read_text(), '    """Return the sum of two double-doubles."""\n'
    assert head in source
    called.write_text(source.replace(head, head + "    a = 2.0 * a + 2.0 * b\n    b = 0.0\n"))
    assert told() == 2.0


def test_what_was_kept_of_classes_that_are_gone_is_compiled_anew(tmp_path: Path) -> None:
    """What numba keeps names the classes of arguments: a new version need not have them any more."""
    package, kept = tmp_path / "resgrid", tmp_path / "kept"
    shutil.copytree(Path(resgrid.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__"))
    environment = os.environ | {"PYTHONPATH": str(tmp_path), "NUMBA_CACHE_DIR": str(kept)}

    def told(name: str) -> float:
        words = [sys.executable, "-c", _GRAPH, name]
        run = subprocess.run(words, env=environment, cwd=tmp_path, capture_output=True, text=True, check=True)
        return float(run.stdout)

    assert told("Graph") == 2.0
    assert any(b"Graph" in index.read_bytes() for index in kept.rglob("*.nbi"))
    for file in package.rglob("*.py"):
        file.write_text(file.read_text().replace("Graph", "Renamed"))
    assert told("Renamed") == 2.0
