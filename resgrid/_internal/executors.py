"""Executors by their names on the command line: ``processes:4``, ``dask://HOST:PORT``, ``mpi``, ``parsl:FILE``."""

from __future__ import annotations

import importlib
import multiprocessing
import os
import runpy
import signal
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from resgrid._internal.extras import install_command
from resgrid.errors import InputError, ToolMissingError

FORMS = "processes[:N], dask://HOST:PORT, mpi or parsl:FILE"
"""What names an executor."""

DASK_SECONDS = 10.0
"""How long a scheduler may take to answer."""

_MOMENT = 0.2
"""Seconds between two looks at the workers of a pool that ends."""


@contextmanager
def open_executor(name: str) -> Iterator[Executor]:
    """Open an executor by name, and close it at the end of the block.

    ``mpi`` makes workers of all ranks but the first, which alone enters the block: start Python as
    ``mpiexec -n N python ...``.  On the others the call serves the first, then ends the process (SystemExit).

    Parameters
    ----------
    name : str
        ``"processes"`` (one for each core), ``"processes:4"``, ``"dask://HOST:PORT"`` (a scheduler's address),
        ``"mpi"``, or ``"parsl:FILE"`` (a Python file that sets ``config``, a `parsl.Config`).

    Yields
    ------
    concurrent.futures.Executor
        For the ``executor`` of `Study.yields`, `spread`, `solve_many` and others.

    Raises
    ------
    InputError
        If nothing is called so, nobody answers at the address, or the file sets no ``config``.
    ToolMissingError
        If the package is not installed.

    Examples
    --------
    >>> with rg.open_executor("processes:1") as executor:
    ...     list(rg.spread(abs, [-2, 3], executor=executor))
    [2, 3]
    """
    if not isinstance(name, str):
        raise InputError(f"there is no executor {name!r}; use {FORMS}")
    kind, colon, rest = name.partition(":")
    if name == "mpi":
        opened = _mpi()
    elif kind == "processes" and (not colon or (rest.isdecimal() and int(rest) > 0)):
        opened = _processes(int(rest or os.cpu_count() or 1))
    elif kind == "dask" and rest.strip("/"):
        opened = _dask(rest.removeprefix("//"))
    elif kind == "parsl" and rest:
        opened = _parsl(rest)
    else:
        raise InputError(f"there is no executor {name!r}; use {FORMS}")
    with opened as executor:
        yield executor


def renewed(executor: Executor) -> Executor | None:
    """A pool like one whose workers died; None for other executors."""
    kind = type(executor)
    if kind.__module__.partition(".")[0] == "loky":
        pool: Executor = importlib.import_module("loky").get_reusable_executor(getattr(executor, "_max_workers", None))
        return pool
    if isinstance(executor, ProcessPoolExecutor):
        # The attributes are private, and have been the same since Python 3.7.
        return ProcessPoolExecutor(
            getattr(executor, "_max_workers"),  # noqa: B009
            mp_context=executor._mp_context,
            initializer=executor._initializer,
            initargs=executor._initargs,
        )
    return None


@contextmanager
def _processes(count: int) -> Iterator[Executor]:
    context = multiprocessing.get_context("spawn")
    executor = ProcessPoolExecutor(count, mp_context=context, initializer=_follow_parent)
    try:
        yield executor
    finally:
        _end(executor)


def _end(executor: ProcessPoolExecutor) -> None:
    """Shut a pool down; a worker that dies meanwhile with the lock of their queue takes the others along.

    The pool itself would wait for these for ever.
    """
    workers = list((executor._processes or {}).values())
    closing = threading.Thread(target=executor.shutdown, name="resgrid ends its workers")
    closing.start()
    while closing.is_alive():
        closing.join(_MOMENT)
        if any(worker.exitcode for worker in workers):
            for worker in workers:
                worker.terminate()


def _follow_parent() -> None:
    """In a worker: leave interrupts to the parent, and end when it does, however it ended."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()

    def follow() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=follow, name="resgrid follows its parent", daemon=True).start()


@contextmanager
def _dask(address: str) -> Iterator[Executor]:
    distributed = _needed("distributed", "dask")
    try:
        client = distributed.Client(f"tcp://{address}", timeout=DASK_SECONDS, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(f"no dask scheduler answers at {address}: {error}; start one with: dask scheduler") from error
    with client, client.get_executor(pure=False) as executor:
        yield executor


@contextmanager
def _mpi() -> Iterator[Executor]:
    futures = _needed("mpi4py.futures", "mpi")
    mpi = importlib.import_module("mpi4py.MPI")
    world = mpi.COMM_WORLD
    if world.size < 2:
        library, beside = mpi.get_vendor()[0], Path(sys.executable).with_name("mpiexec")
        launcher = beside if library == "MPICH" and beside.exists() else "mpiexec"
        raise InputError(
            f"mpi: this process is alone: start it with {launcher} -n N, the one that belongs to {library}, which "
            "mpi4py found, or name the library of another MPI in MPI4PY_LIBMPI"
        )
    with futures.MPICommExecutor(world, root=0) as executor:
        if executor is not None:
            yield executor
            return
    sys.exit(0)


@contextmanager
def _parsl(file: str) -> Iterator[Executor]:
    concurrent = _needed("parsl.concurrent", "parsl")
    try:
        config = runpy.run_path(file)["config"]
    except OSError as error:
        raise InputError(f"{file}: cannot be read ({error.strerror}); name a Python file that sets config") from error
    except Exception as error:
        raise InputError(f"{file}: {error!r}; let it say config = parsl.Config(...)") from error
    if not isinstance(config, importlib.import_module("parsl").Config):
        raise InputError(f"{file}: config is {config!r:.100}; let it say config = parsl.Config(...)")
    try:
        with _interrupts_ignored():
            executor = concurrent.ParslPoolExecutor(config=config)
    except FileNotFoundError as error:
        raise InputError(f"parsl does not find {error.filename}: activate the environment that holds it") from error
    try:
        yield executor
    finally:
        executor.shutdown(wait=False)  # it knows no way to cancel what nobody waits for any more


@contextmanager
def _interrupts_ignored() -> Iterator[None]:
    """Processes begun here leave Ctrl-C to this one, which needs them to the end; only the main thread can say so."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _needed(module: str, extra: str) -> Any:
    try:
        return importlib.import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        raise ToolMissingError(f"{package} is missing ({error}); install it: {install_command(extra)}") from error
