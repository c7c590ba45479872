"""``resgrid chip --executor``: identical files from every executor, also after interrupts and killed processes.

Tests internals: `resgrid._internal.extras`.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.metadata import files
from pathlib import Path

import pytest
from support.cli import COMMAND, call
from support.executors import two_workers

from resgrid._internal.extras import install_command

CHIPS = 200
WORDS = ["--only", "yield", "--most", str(CHIPS), "--half-width", "0.001", "--no-check", "-q"]


def written_alone(scenes: Path, folder: Path, chips: int) -> bytes:
    """Return the file that one process writes for a number of chips."""
    assert call("chip", scenes / "chip.toml", *WORDS, "--most", str(chips), "-o", folder).exit_code == 0
    return (folder / "yield.jsonl").read_bytes()


@pytest.fixture(scope="module")
def alone(scenes: Path, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return the file that one process writes."""
    return written_alone(scenes, tmp_path_factory.mktemp("alone") / "out", CHIPS)


@pytest.mark.slow
def test_mpi_writes_the_file_of_one_process(scenes: Path, tmp_path: Path, alone: bytes) -> None:
    """The test uses mpiexec and the library of the mpich wheel."""
    wheel = {file.name: str(file.locate()) for file in files("mpich") or []}
    mpi = [wheel["mpiexec"], "-n", "3", *COMMAND, "chip", scenes / "chip.toml", "--executor", "mpi"]
    subprocess.run(
        [*mpi, *WORDS, "-o", tmp_path / "out"],
        check=True,
        timeout=300,
        env={**os.environ, "MPI4PY_LIBMPI": wheel["libmpi.so.12"]},
    )
    assert (tmp_path / "out" / "yield.jsonl").read_bytes() == alone


@pytest.mark.slow
def test_dask_writes_the_file_of_one_process(scenes: Path, tmp_path: Path, alone: bytes) -> None:
    with two_workers("dask", tmp_path) as executor:
        address = executor._client.scheduler.address.replace("tcp", "dask")  # type: ignore[attr-defined]
        result = call("chip", scenes / "chip.toml", *WORDS, "--executor", address, "-o", tmp_path / "out")
    assert result.exit_code == 0, result.stderr
    assert (tmp_path / "out" / "yield.jsonl").read_bytes() == alone


PARSL = """import parsl
config = parsl.Config(
    executors=[parsl.HighThroughputExecutor(label="here", max_workers_per_node=2, address="127.0.0.1")], run_dir={!r}
)
"""


@contextmanager
def killed_at_the_end(process: subprocess.Popen[str]) -> Iterator[None]:
    """Kill the processes of a session that are left, so that a failed test does not wait for them."""
    try:
        yield
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "sent", "code"),
    [("processes:2", signal.SIGINT, 130), ("processes:2", signal.SIGKILL, -9), ("parsl", signal.SIGINT, 130)],
)
def test_an_interrupted_or_killed_run_resumes_to_the_same_file(
    scenes: Path, tmp_path: Path, alone: bytes, kind: str, sent: signal.Signals, code: int
) -> None:
    if kind == "parsl":
        kind = f"parsl:{tmp_path / 'config.py'}"
        (tmp_path / "config.py").write_text(PARSL.format(str(tmp_path / "parsl")))
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    words = ["chip", scenes / "chip.toml", *WORDS, "-o", tmp_path / "out"]
    endless = ["--most", "100000", "--half-width", "0.0001"]  # the run must not end before the interrupt
    with subprocess.Popen(
        [*COMMAND, *words, *endless, "--executor", kind], stderr=subprocess.PIPE, text=True, start_new_session=True,
        env=environment,
    ) as process, killed_at_the_end(process):  # fmt: skip
        end = time.monotonic() + 300
        while not any(file.stat().st_size > 1000 for file in tmp_path.glob(".out-*.yield.jsonl")):
            assert process.poll() is None and time.monotonic() < end
            time.sleep(0.01)
        # An interrupt at the terminal reaches all processes; SIGKILL is sent to the parent only.
        os.killpg(process.pid, sent) if sent == signal.SIGINT else process.send_signal(sent)
        if sent == signal.SIGINT and kind == "processes:2":  # a second interrupt must have no effect
            time.sleep(0.1)
            os.killpg(process.pid, sent)
        _, output = process.communicate(timeout=300)  # the output ends when the last worker has gone
        assert process.returncode == code
    assert "Traceback" not in output
    assert not (tmp_path / "out").exists()
    (kept,) = tmp_path.glob(".out-*.yield.jsonl")
    begun = kept.read_bytes()
    shorter = min(len(alone), len(begun))
    assert alone[:shorter] == begun[:shorter]
    chips = max(CHIPS, begun.count(b"\n") - 1)  # the interrupted run may have written more than the reference
    assert call(*words, "--most", str(chips)).exit_code == 0
    expected = alone if chips == CHIPS else written_alone(scenes, tmp_path / "more", chips)
    assert (tmp_path / "out" / "yield.jsonl").read_bytes() == expected


@pytest.mark.parametrize(
    ("name", "message", "code"),
    [
        ("threads", "there is no executor 'threads'; use processes", 2),
        ("processes:0", "there is no executor", 2),
        ("mpi", "mpiexec -n N, the launcher of", 2),
        ("dask://127.0.0.1:1", "no dask scheduler answers at 127.0.0.1:1", 2),
        ("parsl:none.py", "none.py: cannot be read", 2),
        ("parsl:three.py", "three.py: config is 3; it must be a parsl.Config", 2),
    ],
)
def test_invalid_executors_exit_with_2_and_a_message(
    scenes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, message: str, code: int
) -> None:
    monkeypatch.setattr("resgrid._internal.executors.DASK_SECONDS", 0.5)
    monkeypatch.chdir(tmp_path)
    Path("three.py").write_text("config = 3")
    result = call("chip", scenes / "chip.toml", *WORDS, "--executor", name, "-o", tmp_path / "out")
    assert (result.exit_code, message in result.stderr) == (code, True)


@pytest.mark.parametrize(
    ("name", "module", "extra"),
    [("mpi", "mpi4py", "mpi"), ("dask://localhost:1", "distributed", "dask"), ("parsl:none.py", "parsl", "parsl")],
)
@pytest.mark.quick_cases(1)
def test_missing_packages_exit_with_3_and_the_install_command(name: str, module: str, extra: str) -> None:
    script = (
        f"import sys; sys.modules[{module!r}] = None\n"
        f"from resgrid.cli import main; main(['chip', 'no.toml', '--executor', {name!r}])"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 3
    assert f"{module} is missing" in done.stderr and install_command(extra) in done.stderr
