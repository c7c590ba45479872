"""Creation of `concurrent.futures` executors from names such as ``processes:4``, ``mpi`` and ``parsl:FILE``."""

from __future__ import annotations

import importlib
import multiprocessing
import os
import runpy
import signal
import sys
import threading
import weakref
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor, wait as wait_for
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from resgrid._internal.extras import install_command
from resgrid._internal.interrupts import interrupts_deferred, interrupts_ignored
from resgrid.errors import InputError, ToolMissingError

FORMS = "processes[:N], dask://HOST:PORT, mpi or parsl:FILE"
"""List of the accepted names of executors, for messages."""

DASK_SECONDS = 10.0
"""Maximum waiting time for the answer of a dask scheduler, in seconds."""

_POLL_INTERVAL = 0.2
"""Time in seconds between two checks of the workers while a process pool or a dask executor shuts down."""


@contextmanager
def open_executor(name: str) -> Iterator[Executor]:
    """Open an executor by name, and close it at the end of the block.

    With ``mpi``, start Python as ``mpiexec -n N python ...``.  Only rank 0 enters the block.  On every other rank the
    call works as a worker of rank 0 and then ends the process (SystemExit).

    Parameters
    ----------
    name : str
        ``"processes"`` (one for each core), ``"processes:4"``, ``"dask://HOST:PORT"`` (a scheduler's address),
        ``"mpi"``, or ``"parsl:FILE"`` (a Python file that sets ``config``, a `parsl.Config`).

    Yields
    ------
    concurrent.futures.Executor
        An executor for the argument ``executor`` of `Study.yields`, `spread`, `solve_many` and others.

    Raises
    ------
    InputError
        If the name is unknown, no scheduler answers at the address, the file does not set ``config``, or there is only
        one MPI rank.
    ToolMissingError
        If the package of the executor is not installed.

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
    with ExitStack() as stack:
        executor = stack.enter_context(opened)
        try:
            yield executor
        finally:
            with interrupts_deferred():
                stack.close()


def renewed(executor: Executor) -> Executor | None:
    """Return a new pool in place of a broken process pool, with the same number of processes; None for other executors.

    `executor`: the broken executor.  Process pools are those of `concurrent.futures` and of the package loky.
    """
    kind = type(executor)
    if kind.__module__.partition(".")[0] == "loky":
        pool: Executor = importlib.import_module("loky").get_reusable_executor(getattr(executor, "_max_workers", None))
        return pool
    if isinstance(executor, ProcessPoolExecutor):
        # A pool has no public attributes for its settings; these private ones are unchanged since Python 3.7.
        return ProcessPoolExecutor(
            getattr(executor, "_max_workers"),  # noqa: B009
            mp_context=executor._mp_context,
            initializer=executor._initializer,
            initargs=executor._initargs,
        )
    return None


def is_lost_by_dask(error: BaseException) -> bool:
    """Return whether an exception means that dask lost a task.

    In this case dask raises ValueError because it fails to unpack an empty answer.  `error`: exception of the task.
    """
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    place = "" if trace is None else trace.tb_frame.f_globals.get("__name__", "")
    return isinstance(error, ValueError) and "to unpack" in str(error) and place == "distributed.cfexecutor"


@contextmanager
def _processes(count: int) -> Iterator[Executor]:
    """Yield a pool of `count` new (spawned) processes, and end the processes with the block or with this process."""
    context = multiprocessing.get_context("spawn")
    executor = ProcessPoolExecutor(count, mp_context=context, initializer=_follow_parent)
    try:
        yield executor
    finally:
        _end(executor)


def _end(executor: ProcessPoolExecutor) -> None:
    """Wait for the tasks of a process pool and shut it down; if a worker dies during this wait, terminate all workers.

    A dead worker may hold the lock of the queue of tasks, and the pool would then wait for the other workers forever.
    """
    workers = list((executor._processes or {}).values())
    closing = threading.Thread(target=executor.shutdown, name="resgrid ends its workers")
    closing.start()
    while closing.is_alive():
        closing.join(_POLL_INTERVAL)
        if any(worker.exitcode for worker in workers):
            for worker in workers:
                worker.terminate()


def _follow_parent() -> None:
    """Initialize a worker process: ignore Ctrl-C, and exit as soon as the parent process has ended."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()

    def follow() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=follow, name="resgrid follows its parent", daemon=True).start()


@contextmanager
def _dask(address: str) -> Iterator[Executor]:
    """Yield an executor of the dask scheduler at `address` (``HOST:PORT``); raise InputError without an answer."""
    distributed = _needed("distributed", "dask")
    try:
        client = distributed.Client(f"tcp://{address}", timeout=DASK_SECONDS, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(f"no dask scheduler answers at {address}: {error}; start one with: dask scheduler") from error
    with client, DaskExecutor(client) as executor:
        yield executor


class DaskExecutor(Executor):
    """Executor of a dask scheduler that can report whether workers are connected; `client`: client of the scheduler.

    A dask scheduler without workers keeps its tasks forever, so that a result that does not arrive is no sign of a
    loss.
    """

    def __init__(self, client: Any) -> None:
        self._client, self._executor = client, client.get_executor(pure=False)
        self._submitted = weakref.WeakSet[Future[Any]]()

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Send the call ``fn(*args, **kwargs)`` to a worker, and return the future of its result."""
        future: Future[Any] = self._executor.submit(fn, *args, **kwargs)
        self._submitted.add(future)
        return future

    def has_workers(self) -> bool:
        """Return whether a worker is connected to the scheduler; True if the scheduler does not answer."""
        try:
            return bool(self._client.nthreads())
        except OSError:  # the futures of a lost scheduler are cancelled soon
            return True

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Wait for the submitted calls while workers are connected, and cancel the calls that remain without a worker.

        If `wait` is False or `cancel_futures` is True, all unfinished calls are cancelled at once.
        """
        # The executor of dask would wait forever for calls that no worker runs.
        while wait and not cancel_futures and self.has_workers():
            if not wait_for(list(self._submitted), _POLL_INTERVAL).not_done:
                break
        self._executor.shutdown(wait=False)


@contextmanager
def _mpi() -> Iterator[Executor]:
    """On MPI rank 0, yield an executor on the other ranks; on the other ranks, work for rank 0 and end the process.

    Raise InputError if rank 0 is the only rank.
    """
    futures = _needed("mpi4py.futures", "mpi")
    mpi = importlib.import_module("mpi4py.MPI")
    world = mpi.COMM_WORLD
    if world.size < 2:
        library, local = mpi.get_vendor()[0], Path(sys.executable).with_name("mpiexec")
        launcher = local if library == "MPICH" and local.exists() else "mpiexec"
        raise InputError(
            f"mpi: this process is the only rank; start it with {launcher} -n N, the launcher of {library} (which "
            "mpi4py uses), or name the library of another MPI in MPI4PY_LIBMPI"
        )
    with futures.MPICommExecutor(world, root=0) as executor:
        if executor is not None:
            yield executor
            return
    sys.exit(0)


@contextmanager
def _parsl(file: str) -> Iterator[Executor]:
    """Yield a parsl executor with the ``config`` of a Python file; raise InputError if the file defines no ``config``.

    `file`: path of the Python file.
    """
    concurrent = _needed("parsl.concurrent", "parsl")
    try:
        config = runpy.run_path(file)["config"]
    except OSError as error:
        raise InputError(f"{file}: cannot be read ({error.strerror}); name a Python file that sets config") from error
    except Exception as error:
        raise InputError(f"{file}: {error!r}; the file must define config = parsl.Config(...)") from error
    if not isinstance(config, importlib.import_module("parsl").Config):
        raise InputError(f"{file}: config is {config!r:.100}; it must be a parsl.Config(...)")
    try:
        with interrupts_ignored():
            executor = concurrent.ParslPoolExecutor(config=config)
    except FileNotFoundError as error:
        raise InputError(f"parsl cannot find {error.filename}; activate the environment that contains it") from error
    try:
        yield executor
    finally:
        executor.shutdown(wait=False)  # parsl cannot cancel tasks


def _needed(module: str, extra: str) -> Any:
    """Import and return a module of an optional package; raise ToolMissingError if the package is missing.

    `module`: name of the module; `extra`: extra of resgrid whose installation command is in the message.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        raise ToolMissingError(f"{package} is missing ({error}); install it: {install_command(extra)}") from error
