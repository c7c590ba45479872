"""Compiled numba kernels: interrupts, recompilation after source changes, and the cache on disk.

Tests internals: `resgrid._internal.jit`.
"""

import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import resgrid
from resgrid._internal import jit

_SUM = """
import numpy as np
from resgrid.circuit.kernels import add_flows
net = np.zeros((3, 2))
add_flows(np.array([[0, 1]], dtype=np.int32), np.ones(1), np.ones(1), np.zeros(1), *net)
print(net[0, 1])
"""

_GRAPH = """
import numpy as np
from resgrid.solvers.laplacian import Graph
from resgrid.solvers.multigrid.graph_coarsening import aggregate_graph
rows = np.array([0, 1, 2], dtype=np.int32), np.array([1, 0], dtype=np.int32)
graph = Graph(*rows, np.ones(2), np.ones(2))
print(aggregate_graph(graph, np.zeros(2, dtype=np.int32), 1)[3][0])
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


@pytest.mark.skipif(not hasattr(signal, "SIGALRM"), reason="the system has no alarm signal")
def test_an_interrupt_during_a_solve_raises_keyboard_interrupt() -> None:
    """Numba crashes Python while it creates a named tuple, and raises SystemError while it creates an array."""
    run = subprocess.run([sys.executable, "-c", _INTERRUPTED], capture_output=True, text=True, timeout=300, check=False)
    assert run.returncode == 0, run.stderr


def _run(folder: Path, script: str) -> float:
    """Run a script with the copy of resgrid in a folder, and return the number that the script prints."""
    environment = os.environ | {"PYTHONPATH": str(folder), "NUMBA_CACHE_DIR": str(folder / "cache")}
    run = subprocess.run(
        [sys.executable, "-c", script], env=environment, cwd=folder, capture_output=True, text=True, check=True
    )
    return float(run.stdout)


@pytest.fixture
def package(tmp_path: Path) -> Path:
    copy = tmp_path / "resgrid"
    shutil.copytree(Path(resgrid.__file__).parent, copy, ignore=shutil.ignore_patterns("__pycache__"))
    return copy


@pytest.mark.slow
def test_a_change_of_a_called_function_in_another_file_recompiles_its_kernels(package: Path) -> None:
    assert _run(package.parent, _SUM) == _run(package.parent, _SUM) == 1.0
    called = package / "solvers" / "scaled_kernels.py"
    source = called.read_text()
    changed, replaced = re.subn(r"_two_sum\(a, b\)(?=\n    u, v =)", "_two_sum(2.0 * (a + b), 0.0)", source)
    assert replaced == 1
    called.write_text(changed)
    assert _run(package.parent, _SUM) == 2.0


@pytest.mark.slow
def test_renamed_argument_classes_recompile_their_kernels(package: Path) -> None:
    """The index of cached kernels contains pickled argument types, whose classes a new version may have renamed."""
    assert _run(package.parent, _GRAPH) == 2.0
    assert any(b"Graph" in index.read_bytes() for index in (package.parent / "cache").rglob("*.nbi"))
    for file in package.rglob("*.py"):
        file.write_text(file.read_text().replace("Graph", "Renamed"))
    assert _run(package.parent, _GRAPH.replace("Graph", "Renamed")) == 2.0


@pytest.mark.slow
def test_unchanged_sources_keep_the_cached_kernels(package: Path) -> None:
    assert _run(package.parent, _SUM) == 1.0
    before = {file: file.stat().st_mtime_ns for file in (package.parent / "cache").rglob("*.nb[ic]")}
    (package / "__init__.py").touch()
    assert _run(package.parent, _SUM) == 1.0
    assert before == {file: file.stat().st_mtime_ns for file in (package.parent / "cache").rglob("*.nb[ic]")}


def test_kernels_use_only_public_names_of_numba() -> None:
    """Private names change between releases; every file of the package is searched for the known ones."""
    for file in Path(resgrid.__file__).parent.rglob("*.py"):
        found = re.search(
            r"numba\._|numba\.core\.(?!cgutils)|from numba\.core import (?!cgutils)|\b_nrt\b", file.read_text()
        )
        assert found is None, f"{file}: {found and found[0]}"


def test_a_kernel_without_a_folder_for_its_machine_code_works_with_a_warning() -> None:
    """Numba finds no folder for a function without a source file, as for a user who can write no folder."""
    names: dict[str, Callable[[float], float]] = {}
    exec("def doubled(x):\n    return 2.0 * x\n", names)
    jit._warn_without_cache.cache_clear()
    with pytest.warns(UserWarning, match=r"set the variable NUMBA_CACHE_DIR to a folder that you can write"):
        doubled = jit.kernel(names["doubled"])
    assert doubled(1.5) == 3.0 and jit.cache_folder(doubled) is None
