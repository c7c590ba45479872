"""``python -m resgrid.cli.warm``: kernels compiled in one process are loaded from the cache by later processes.

Tests internals: `resgrid.cli`, `resgrid.cli.warm`.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from resgrid.cli import kernel_warmup
from resgrid.cli.warm import command

SCENE = Path(__file__).resolve().parents[2] / "examples" / "scenes" / "rooms.toml"

COMPILED = """
import sys
import numba.core.event as event
import resgrid as rg
from resgrid.cli.kernel_warmup import CASES

class Count(event.Listener):
    names = set()
    def on_start(self, e):
        self.names.add(str(e.data["dispatcher"]))
    def on_end(self, e):
        pass

count = Count()
event.register("numba:compile", count)
rg.build_space(rg.read_scene(sys.argv[1]))
print(len(count.names))
"""

LAST = """
import sys
import resgrid as rg
from resgrid.cli.kernel_warmup import compile_last_stages
from resgrid.planning import kernels as paths

def signatures():
    kernels = paths.trace, paths.clearance
    return [(kernel if hasattr(kernel, "signatures") else kernel.__wrapped__).signatures for kernel in kernels]

compile_last_stages()
known = signatures()
assert all(known)
scene, deck = sys.argv[1:]
path = rg.plan(rg.read_scene(scene)).path((0.6, 5.3))
assert path.outcome is rg.Outcome.REACHED and path.clearance > 0
rg.write_spice(rg.solve(rg.compile_space(path.space)), deck)
rg.read_spice(deck)
assert signatures() == known
"""


def compiled(folder: Path) -> int:
    """Return the number of kernels that sampling a scene compiles in a new process that keeps them in a folder."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder)}
    words = [sys.executable, "-c", COMPILED, str(SCENE)]
    return int(subprocess.run(words, capture_output=True, text=True, check=True, env=environment).stdout)


@pytest.mark.parametrize("case", kernel_warmup.CASES)
@pytest.mark.quick_cases(4)
def test_every_warmup_case_runs(case):
    kernel_warmup.CASES[case]()


def test_warmup_omits_robots_whose_packages_are_missing(monkeypatch):
    for name in ("coal", "trimesh"):
        monkeypatch.setitem(sys.modules, name, None)
    kernel_warmup.CASES["joints"]()


@pytest.mark.slow
def test_a_process_loads_the_kernels_that_another_has_compiled(tmp_path):
    assert compiled(tmp_path) > 0
    assert compiled(tmp_path) == 0


def _fail() -> None:
    raise ArithmeticError


def test_warmup_exits_with_0_and_with_another_code_after_a_failure(monkeypatch):
    monkeypatch.setattr(kernel_warmup, "compile_kernels", lambda _jobs: iter(kernel_warmup.CASES))
    assert CliRunner().invoke(command, ["--jobs", "2"]).exit_code == 0

    def broken(_jobs):
        yield "plane"
        _fail()

    monkeypatch.setattr(kernel_warmup, "compile_kernels", broken)
    assert CliRunner().invoke(command, []).exit_code != 0


@pytest.mark.slow
def test_compile_kernels_yields_every_case_with_two_processes(monkeypatch):
    monkeypatch.setattr(kernel_warmup, "CASES", {"many": kernel_warmup.CASES["many"]})
    assert list(kernel_warmup.compile_kernels(2)) == ["many"]
