"""Distribute chips over the workers of every executor: utilization of workers, and equality of the results files.

``python -m benchmarks.executors NAME WORKERS CHIPS SIDE FILE`` performs one run and prints one line of JSON.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, files
from pathlib import Path
from typing import Any

from benchmarks.chips import grid
from benchmarks.rows import Row, Scale, Spread
from resgrid._internal.executors import open_executor
from resgrid.chip.study_analyses import study
from resgrid.scene.chip import Chip, Readout

_NAMES = ("processes", "loky", "dask", "mpi", "parsl")
_PARSL = """import parsl
config = parsl.Config(
    executors=[parsl.HighThroughputExecutor(label="here", max_workers_per_node={}, address="127.0.0.1")], run_dir={!r}
)
"""


@contextmanager
def opened(name: str, workers: int, folder: Path) -> Iterator[Executor | None]:
    """Yield an executor with a number of workers on this computer; None for this process only."""
    if name == "alone":
        yield None
    elif name == "loky":
        from loky import get_reusable_executor

        yield get_reusable_executor(workers)
    elif name == "dask":
        from distributed import LocalCluster

        free_port = {"dashboard_address": "127.0.0.1:0"}  # without a dashboard it would still be 8787
        with LocalCluster(
            n_workers=workers, threads_per_worker=1, dashboard_address=None, scheduler_kwargs=free_port
        ) as cluster:
            # Replace each dead worker, also one that dies before its nanny knows that it has started.
            cluster.adapt(minimum=workers, maximum=workers)
            with open_executor(cluster.scheduler_address.replace("tcp", "dask")) as executor:
                yield executor
    else:
        config = folder / "config.py"
        config.write_text(_PARSL.format(workers, str(folder / "parsl")))
        words = {"processes": f"processes:{workers}", "mpi": "mpi", "parsl": f"parsl:{config}"}
        with open_executor(words[name]) as executor:
            yield executor


def run(name: str, workers: int, count: int, side: int, file: Path) -> dict[str, float]:
    """Simulate chips; return the seconds, and the fraction of the workers' time in tasks after the first result."""
    ended: list[tuple[float, float]] = []

    def note(future: Future[Any]) -> None:
        with contextlib.suppress(BaseException):
            if (answer := future.result()) is not None:
                ended.append((time.perf_counter(), answer[1]))

    chip = study(grid(side), Chip(mismatch=0.02, readout=Readout(bits=10)))
    with opened(name, workers, file.parent) as executor:
        if executor is not None:
            submit = executor.submit

            def noted(*work: Any) -> Future[Any]:
                future = submit(*work)
                future.add_done_callback(note)
                return future

            executor.submit = noted  # type: ignore[method-assign, assignment]
        begin = time.perf_counter()
        chip.yields(trials=count, half_width=1e-6, executor=executor, checkpoint=file)
        seconds = time.perf_counter() - begin
    ended.sort()
    if len(ended) <= 2 * workers:
        return {"seconds": seconds, "busy": 1.0}
    first, last = ended[2 * workers - 1][0], ended[-1][0]  # earlier tasks may include the start of workers
    busy = sum(end - max(first, end - spent) for end, spent in ended if end > first) / (workers * (last - first))
    return {"seconds": seconds, "busy": busy}


def started(name: str, workers: int, count: int, side: int, file: Path) -> subprocess.Popen[str]:
    """Start a run in a separate process, under mpiexec for MPI."""
    words = [sys.executable, "-m", "benchmarks.executors", name, str(workers), str(count), str(side), str(file)]
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = {**os.environ, "PATH": path, "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
    if name == "mpi":
        wheel = {item.name: str(item.locate()) for item in files("mpich") or []}
        words = [wheel["mpiexec"], "-n", str(workers + 1), *words]
        environment["MPI4PY_LIBMPI"] = wheel["libmpi.so.12"]
    pipes: Any = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(words, env=environment, start_new_session=True, **pipes)


def executors(scale: Scale) -> list[Row]:
    """Section: chips on 1, 2 and 4 workers of every executor, then runs with killed processes."""
    count, side = {"tiny": (64, 12), "quick": (2000, 64), "full": (10_000, 64)}[scale.name]
    with tempfile.TemporaryDirectory() as folder:
        alone = Path(folder) / "alone"
        rows = [_row("alone", 1, count, side, alone, None)]
        for name in _NAMES:
            for workers in (1, 2, 4):
                rows.append(_row(name, workers, count, side, Path(folder) / f"{name}{workers}", alone))
        rows.append(_killed("one worker", count, side, Path(folder) / "one", alone))
        rows.append(_killed("all", count, side, Path(folder) / "all", alone))
    return rows


def _row(name: str, workers: int, count: int, side: int, file: Path, alone: Path | None) -> Row:
    title = f"{count:,} chips of {side}^2, {workers} worker{'s' * (workers > 1)}"
    try:
        process = started(name, workers, count, side, file)
    except PackageNotFoundError as error:
        return Row(title, None, None, "", name, f"missing: {error}")
    said, errors = process.communicate()
    if process.returncode:
        return Row(title, None, None, "", name, f"failed: {errors.strip().splitlines()[-1:]}")
    found = json.loads(said)
    busy = found["busy"]
    return Row(title, found["seconds"], Spread(busy, busy, busy), "of its workers' time", name, _same(file, alone))


def _killed(who: str, count: int, side: int, file: Path, alone: Path) -> Row:
    """Kill a worker during a run, which must complete, or kill all processes and start the run again."""
    process = started("processes", 2, count, side, file)
    size = alone.stat().st_size
    while process.poll() is None and (not file.exists() or file.stat().st_size < size // 2):
        time.sleep(0.01)
    begin = time.perf_counter()
    if who == "all":
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        process = started("processes", 2, count, side, file)
    else:
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
        os.kill(int(children[-1]), signal.SIGKILL)
    _, errors = process.communicate()
    note = _same(file, alone) if not process.returncode else f"failed: {errors.strip().splitlines()[-1:]}"
    return Row(f"{who} killed in the middle", time.perf_counter() - begin, None, "", "processes", note)


def _same(file: Path, alone: Path | None) -> str:
    if alone is None:
        return ""
    return "the same file" if file.read_bytes() == alone.read_bytes() else "ANOTHER FILE"


if __name__ == "__main__":
    name, *rest = sys.argv[1:]
    workers, count, side = map(int, rest[:3])
    sys.stdout.write(json.dumps(run(name, workers, count, side, Path(rest[3]))) + "\n")
