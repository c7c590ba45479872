"""Targets of the Makefile, as ``make -n`` prints them."""

from __future__ import annotations

import os
import pty
import re
import shutil
import subprocess
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[1]
pytestmark = pytest.mark.skipif(shutil.which("make") is None, reason="there is no make")


def commands_of(*targets: str, **options: int) -> str:
    """Return the commands of targets, as if no target were up to date."""
    environment = {key: value for key, value in os.environ.items() if key not in ("MAKEFLAGS", "MAKELEVEL", "MFLAGS")}
    words = ["make", "-n", "-B", *targets]
    options = {"stderr": subprocess.DEVNULL, **options}
    done = subprocess.run(words, cwd=PROJECT, stdout=subprocess.PIPE, text=True, check=True, env=environment, **options)
    return done.stdout


def test_the_demo_installs_the_live_page_without_compiling_kernels() -> None:
    commands = commands_of("demo")
    assert "--editable '.[live]'" in commands
    assert "resgrid run examples/scenes/rooms.toml" in commands
    assert "resgrid.cli.warm" not in commands


def test_kernels_are_compiled_before_tests_and_by_make_warm() -> None:
    for target in ("test", "test-slow"):
        assert commands_of(target).index("-m resgrid.cli.warm") < commands_of(target).index("-m pytest")
    assert "-m resgrid.cli.warm" in commands_of("warm")


def test_make_test_and_make_test_slow_run_every_test_once() -> None:
    quick, slow = (commands_of(target).splitlines()[-1] for target in ("test", "test-slow"))
    assert quick.endswith(' -m "not slow"') and slow.endswith(" -m slow")
    assert quick.removesuffix('"not slow"') == slow.removesuffix("slow")
    steps = re.findall(r"^run \d+m ([a-z-]+)", (PROJECT / ".ci" / "run").read_text(), re.MULTILINE)
    assert {"check", "test", "test-slow", "targets", "docs"} <= set(steps)


@pytest.mark.parametrize("target", ["test", "test-slow"])
def test_requirements_of_tests_are_installed_before_the_tests_run(target: str) -> None:
    commands = commands_of(target)
    for script in ("install_ngspice", "install_chromium", "unpack_kicad", "install_petsc"):
        assert commands.index(script) < commands.index("-m pytest")


def test_pip_prints_progress_on_a_terminal_only() -> None:
    leader, follower = pty.openpty()
    try:
        assert "--quiet" not in commands_of(".venv/.installed", stderr=follower)
    finally:
        os.close(leader)
        os.close(follower)
    assert "--quiet" in commands_of(".venv/.installed")


@pytest.mark.parametrize(("given", "seed"), [((), "SEED= "), (("SEED=7",), "SEED=7 ")])
def test_fuzzing_has_a_random_seed_unless_one_is_given(given: tuple[str, ...], seed: str) -> None:
    assert seed in commands_of("fuzz", *given)
