"""Loops that are kept on disk."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import resgrid

_SUM = """
import numpy as np
from resgrid.circuit.kernels import add_flows
net = np.zeros((3, 2))
add_flows(np.array([[0, 1]], dtype=np.int32), np.ones(1), np.ones(1), np.zeros(1), *net)
print(net[0, 1])
"""


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
    called = package / "solvers" / "extended_kernels.py"
    source, head = called.read_text(), '    """Sum of two double-doubles."""\n'
    assert head in source
    called.write_text(source.replace(head, head + "    a = 2.0 * a + 2.0 * b\n    b = 0.0\n"))
    assert told() == 2.0
