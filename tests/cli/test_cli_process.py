"""Behaviour of real processes: imports, interrupts, closed and full outputs, and terminals.

Tests internals: `resgrid.cli`.
"""

from __future__ import annotations

import json
import os
import pty
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
from support.cli import COMMAND

import resgrid
from resgrid.cli import terminal

PATIENCE = 300.0
"""Time limit of a process on a busy computer, in seconds."""

LIGHT = {"resgrid", "click", *sys.stdlib_module_names}


def packages_after(code: str) -> set[str]:
    """Return the top-level packages that `code` loads."""
    script = (
        f"import sys\nbefore = set(sys.modules)\ntry:\n    {code}\nexcept SystemExit:\n    pass\n"
        "print(*set(sys.modules) - before, file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    return {name.partition(".")[0] for name in done.stderr.split()}


@pytest.mark.parametrize(
    "code",
    [
        "import resgrid",
        "from resgrid.cli import main; main(['--help'])",
        "from resgrid.cli import main; main(['run', '--help'])",
        "from resgrid.cli import main; main(['--version'])",
    ],
)
def test_import_and_help_load_only_the_standard_library_and_click(code):
    """``make bench SECTIONS=start`` measures the time."""
    loaded = packages_after(code)
    assert "resgrid" in loaded
    assert loaded - LIGHT == set()


def test_public_names_exist_and_have_docstrings_and_stubs():
    stub = Path(resgrid.__file__).with_suffix(".pyi").read_text()
    for name in resgrid.__all__:
        value = getattr(resgrid, name)
        if name != "__version__":
            assert value.__doc__, name
            assert re.search(rf"\b{name}\b", stub), f"{name} is hidden from type checkers"
    assert dir(resgrid) == resgrid.__all__
    with pytest.raises(AttributeError, match="no attribute 'solv'"):
        _ = resgrid.solv


@pytest.mark.slow
def test_a_closed_pipe_exits_with_141_without_a_message(scenes):
    # The deck is larger than the buffer of a pipe, so that writing fails at the closed end; requires buffered output.
    words = [*COMMAND, "compile", str(scenes / "rooms.toml"), "--boundary", "dirichlet"]
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONUNBUFFERED"}
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment) as process:
        assert process.stdout is not None and process.stderr is not None
        assert process.stdout.readline() == b"* Rooms, dirichlet\n"
        process.stdout.close()
        assert process.stderr.read() == b""
        assert process.wait(timeout=PATIENCE) == 141


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no device that is always full")
@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize("options", [(), ("--json",)])
@pytest.mark.quick_cases(2)
def test_a_full_standard_output_exits_with_2_and_one_message(scenes, options, unbuffered):
    words = [*COMMAND, "path", str(scenes / "lesson.toml"), *options]
    env = os.environ | {"PYTHONUNBUFFERED": unbuffered}
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(words, stdout=full, stderr=subprocess.PIPE, text=True, check=False, env=env)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1 and "No space left" in done.stderr


@pytest.fixture
def default_hangup() -> Iterator[None]:
    """Let child processes receive SIGHUP, which they would ignore if the tests ran below ``nohup``."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.mark.usefixtures("default_hangup")
@pytest.mark.parametrize(("sent", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)])
@pytest.mark.quick_cases(1)
def test_an_interrupt_leaves_no_incomplete_files(scenes, tmp_path, sent, code):
    words = [*COMMAND, "run", str(scenes / "rooms.toml"), "-o", str(tmp_path / "out"), "-v"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        while not process.stderr.readline().startswith("build the space"):
            assert process.poll() is None
        process.send_signal(sent)
        assert process.wait(timeout=PATIENCE) == code
        assert process.stderr.read().splitlines()[-1] == "resgrid: interrupted; incomplete files were removed"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("left_behind", [True, False])
@pytest.mark.quick_cases(1)
def test_a_second_interrupt_does_not_stop_the_cleanup(scenes, tmp_path, left_behind):
    """The finalizer that the first interrupt starts sends the second one and then needs 0.2 s."""
    program = f"""
import os, signal, sys, time, weakref
from resgrid import cli
from resgrid.cli import terminal

class Thing:
    pass

def end():
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(0.2)
    print("ended", flush=True)

thing = Thing()
weakref.finalize(thing, end)

def interrupted(*arguments, **options):
    if {left_behind}:
        terminal.threading.Thread(target=time.sleep, args=(600,), name=terminal._WORKER, daemon=True).start()
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(600)

from resgrid.cli import scenes
scenes.stage = interrupted
sys.argv = ["resgrid", "path", {str(scenes / "lesson.toml")!r}]
cli.main(prog_name="resgrid")
"""
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False, timeout=PATIENCE
    )
    assert (done.returncode, done.stdout) == (130, "ended\n"), done.stderr
    assert done.stderr == "resgrid: interrupted; incomplete files were removed\n"


@pytest.mark.slow
def test_standard_output_contains_only_json_with_the_json_option(scenes):
    words = [*COMMAND, "path", str(scenes / "lesson.toml"), "--json", "-v"]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    assert json.loads(done.stdout)["paths"][0]["outcome"] == "reached"
    assert "solve the dirichlet chip" in done.stderr


@pytest.mark.parametrize("colourless", [False, True])
@pytest.mark.quick_cases(1)
def test_errors_are_coloured_on_a_terminal_only(tmp_path, colourless):
    environment = {key: value for key, value in os.environ.items() if key != "NO_COLOR"}
    environment |= {"NO_COLOR": "1"} if colourless else {}
    output = on_terminal(["path", str(tmp_path / "no.toml")], environment)
    assert "no such file" in output
    assert ("\x1b[31mresgrid: error: \x1b[0m" in output) is not colourless
    assert "resgrid: error: " in output
    done = subprocess.run([*COMMAND, "path", "no.toml"], capture_output=True, text=True, check=False, env=environment)
    assert "\x1b[" not in done.stderr


def test_the_time_left_ignores_trials_of_an_earlier_run(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(terminal, "time", SimpleNamespace(perf_counter=lambda: now[0]))
    stage = terminal.Stage()
    for seconds, done in ((1.0, 900), (2.0, 910)):
        now[0] = seconds
        stage.count(done, 1000)
    assert stage.status() == "about 9 s left"


@pytest.mark.parametrize(("estimate", "expected"), [(0.01, "5 s so far"), (2.0, "5 s so far, longer than expected")])
def test_only_long_stages_are_reported_as_longer_than_expected(monkeypatch, estimate, expected):
    now = [0.0]
    monkeypatch.setattr(terminal, "time", SimpleNamespace(perf_counter=lambda: now[0]))
    stage = terminal.Stage(estimate)
    now[0] = 5.0
    assert stage.status() == expected


def test_a_progress_bar_shows_the_time_left_on_a_terminal_only(tmp_path):
    script = """
import sys, threading
from resgrid.cli import terminal

shown, started_bar = threading.Event(), terminal._started_bar

def started(*words):
    bar = started_bar(*words)
    shown.set()
    return bar

terminal._started_bar, terminal.BAR_DELAY = started, 0.0
with terminal.stage("follow the current", steps=4) as progress:
    progress.advance()
    assert shown.wait(300) if sys.stderr.isatty() else True
shown.clear()
with terminal.stage("solve the chip", seconds=1000.0):
    assert shown.wait(300) if sys.stderr.isatty() else True
"""
    with subprocess.Popen(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    ) as elsewhere:
        output = on_terminal([], {**os.environ, "TERM": "xterm"}, [sys.executable, "-c", script])
        assert elsewhere.communicate() == (b"", None) and elsewhere.returncode == 0
    assert "follow the current" in output and "solve the chip" in output
    assert re.search(r"about \d+ s left", output)


def test_is_first_run_is_false_with_a_cached_kernel(tmp_path: Path) -> None:
    script = (
        "from resgrid.cli.scenes import is_first_run\nfrom resgrid._internal.jit import cache_folder\n"
        "from resgrid.solvers.csr_kernels import conductances_by_row\nprint(is_first_run())\n"
        "(cache_folder(conductances_by_row) / 'csr_kernels.conductances_by_row-9.py311.nbi').touch()\n"
        "print(is_first_run())"
    )
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["True", "False"]


@pytest.mark.slow
def test_a_small_path_loads_neither_scipy_nor_matplotlib(scenes: Path) -> None:
    script = (
        "import gc, sys\nfrom resgrid.cli import main\nbefore = gc.get_threshold()\n"
        "try:\n    main(sys.argv[1:])\nexcept SystemExit as end:\n    assert not end.code\n"
        "assert gc.get_threshold() == before\n"
        "loaded = {'scipy.linalg', 'scipy.ndimage', 'scipy.sparse', 'matplotlib'} & set(sys.modules)\n"
        "assert not loaded, loaded\n"
        "import scipy.linalg.cython_blas\n"
    )
    subprocess.run([sys.executable, "-c", script, "path", scenes / "lesson.toml"], check=True, capture_output=True)


def on_terminal(words: list[str], environment: dict[str, str], command: list[str] | None = None) -> str:
    """Return the standard error of a process whose standard error is a terminal."""
    leader, follower = pty.openpty()
    process = subprocess.Popen(
        [*(command or COMMAND), *words], stdout=subprocess.DEVNULL, stderr=follower, env=environment
    )
    os.close(follower)
    output = b""
    while True:
        try:
            part = os.read(leader, 4096)
        except OSError:  # the other end is closed
            break
        if not part:
            break
        output += part
    process.wait(timeout=PATIENCE)
    os.close(leader)
    return output.decode()
