"""Warm-up: later processes load the cached kernels."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from resgrid.cli import kernel_warmup
from resgrid.cli.warm import command

COMPILED = """
import sys
import numba.core.event as event
from resgrid.cli.kernel_warmup import CASES

class Count(event.Listener):
    names = set()
    def on_start(self, e):
        self.names.add(str(e.data["dispatcher"]))
    def on_end(self, e):
        pass

count = Count()
event.register("numba:compile", count)
CASES[sys.argv[1]]()
print(len(count.names))
"""


def compiled(case: str, folder: Path) -> int:
    """Return the number of functions that a case compiles in a new process with a cache folder."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder)}
    done = subprocess.run(
        [sys.executable, "-c", COMPILED, case], capture_output=True, text=True, check=True, env=environment
    )
    return int(done.stdout)


@pytest.mark.parametrize("case", kernel_warmup.CASES)
def test_every_case_runs(case):
    kernel_warmup.CASES[case]()


def test_a_process_loads_the_kernels_that_another_has_compiled(tmp_path):
    assert compiled("decks", tmp_path) > 0
    assert compiled("decks", tmp_path) == 0


def _fail() -> None:
    raise ArithmeticError


def test_the_command_ends_with_a_code_for_scripts(monkeypatch):
    monkeypatch.setattr(kernel_warmup, "compile_kernels", lambda _jobs: iter(kernel_warmup.CASES))
    assert CliRunner().invoke(command, ["--jobs", "2"]).exit_code == 0

    def broken(_jobs):
        yield "plane"
        _fail()

    monkeypatch.setattr(kernel_warmup, "compile_kernels", broken)
    assert CliRunner().invoke(command, []).exit_code != 0


def test_processes_share_the_cases(monkeypatch):
    monkeypatch.setattr(kernel_warmup, "CASES", {"decks": kernel_warmup.CASES["decks"]})
    assert list(kernel_warmup.compile_kernels(2)) == ["decks"]
