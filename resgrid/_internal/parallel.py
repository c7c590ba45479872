"""Ordered parallel map over any `concurrent.futures` executor; tasks of workers that died are submitted again.

Items are divided into tasks of about one second.  The number of submitted tasks (the window) grows until all workers
are busy.  Data that all items use is sent to every worker once: a task contains the hash of the data, and the worker
reads the data from a file and caches the data.  If a worker cannot read the file, the task is sent again together with
the data.
"""

from __future__ import annotations

import contextlib
import queue
import tempfile
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import (
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ThreadPoolExecutor,
    wait,
)
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from resgrid._internal.executors import DaskExecutor, is_lost_by_dask, renewed
from resgrid._internal.interrupts import interrupts_deferred
from resgrid._internal.shared_data import SharedData, packed, unpacked
from resgrid.errors import WorkerError

_SECONDS = 1.0
"""Target duration of a task in a worker, in seconds."""

_SECONDS_ALONE = 0.2
"""Target duration of a task without an executor, in seconds; it limits the wasted work if iteration stops early."""

_FIRST_WINDOW, _MAX_WINDOW = 4, 4096
"""Initial and maximum number of tasks that are submitted to the executor at one time (the window)."""

_AHEAD = 16
"""Maximum number of finished tasks that wait for an earlier one, as a multiple of the window (see `_FIRST_WINDOW`)."""

_MAX_DEATHS = 3
"""Number of worker deaths during a task at which the task fails; after two deaths, the task runs alone."""

_SECONDS_WITHOUT_WORKERS = 300.0
"""Time in seconds after the last worker of a dask scheduler has gone at which the job fails."""

_SECONDS_BETWEEN_COUNTS = 5.0
"""Time in seconds without a result after which the workers of a dask scheduler are counted."""

_LOST = frozenset({"WorkerLost", "ManagerLost"})
"""Class names of the parsl exceptions that report the death of a worker."""


Results = Sequence[Any] | NDArray[Any]


@dataclass(frozen=True, eq=False)
class JobPart:
    """Part of a job: a function and its items (arguments); ``function(shared, items)`` returns one result per item.

    `shared`: argument that is common to all items; `items`: a range, list or array that can be sliced; `name`: name of
    the items in messages, such as "trials".
    """

    function: Callable[[Any, Any], Results]
    shared: Any
    items: Results
    name: str = "items"


@dataclass(eq=False)
class _Task:
    """Range of the items of a `JobPart` that one worker computes in one call.

    `part`: the job part; `shared`: the shared argument of the part as a `SharedData`, or the object itself for
    threads; `begin`, `end`: range of the items in the part, without `end`; `number`: position of the first item among
    the items of all parts; `deaths`: number of workers that died during the task; `sent`: submission time in seconds
    (`time.perf_counter`).
    """

    part: JobPart
    shared: Any
    begin: int
    end: int
    number: int
    deaths: int = 0
    sent: float = 0.0

    @property
    def place(self) -> str:
        """Name of the items and first and last item of the task, for messages, such as "items 3 to 7"."""
        items = self.part.items[self.begin : self.end]
        first, last = (items[0], items[-1]) if isinstance(items, range) else (self.begin, self.end - 1)
        return f"{self.part.name} {first} to {last}"


def in_order(parts: Iterable[JobPart], executor: Executor | None = None) -> Generator[Any, None, None]:
    """Iterate over the results of all items (arguments of a function), part by part, in the order of the items.

    `parts`: parts of the job, each with one function and its items; `executor`: executor of the tasks, None for this
    process.  The results do not depend on the executor, the number of its workers or their order.  A broken process
    pool is replaced, and its tasks are submitted again.  Close the iterator (`contextlib.closing`) to stop early and to
    cancel the waiting tasks.  The exception of an item is raised at its position.

    Raises
    ------
    WorkerError
        If workers die repeatedly during the same items, or a broken executor cannot be replaced.
    """
    if executor is None:
        yield from _alone(parts)
        return
    with tempfile.TemporaryDirectory(prefix="resgrid-") as folder:
        chunker = _Chunker(parts, None if isinstance(executor, ThreadPoolExecutor) else Path(folder))
        scheduler = _Scheduler(executor, chunker)
        try:
            yield from scheduler.results()
        finally:
            scheduler.close()


def spread(
    function: Callable[..., Any], items: Iterable[Any], *shared: Any, executor: Executor | None = None
) -> Iterator[Any]:
    """Call a function for many items, such as scenes or starts, on the workers of an executor.

    Parameters
    ----------
    function : callable
        Function that is called as ``function(item, *shared)``.  Worker processes import the function by its name.
    items : iterable
        Items that can be pickled.
    *shared
        Further arguments of all calls; sent to every worker once.
    executor : concurrent.futures.Executor, optional
        Executor of the calls; by default the calls are made one after the other in this process.

    Returns
    -------
    iterator
        Return values in the order of the items, each as soon as it and all earlier ones are known.

    Raises
    ------
    InputError
        If `shared` cannot be pickled.
    WorkerError
        If workers die repeatedly during the same items.

    Examples
    --------
    >>> from concurrent.futures import ThreadPoolExecutor
    >>> with ThreadPoolExecutor(2) as threads:
    ...     list(rg.spread(pow, [1, 2, 3], 2, executor=threads))
    [1, 4, 9]
    """
    return in_order([JobPart(_call_each, (function, shared), list(items))], executor)


def _call_each(shared: tuple[Callable[..., Any], tuple[Any, ...]], items: Sequence[Any]) -> list[Any]:
    """Return the list of ``function(item, *rest)`` for all items; `shared`: the pair ``(function, rest)``."""
    function, rest = shared
    return [function(item, *rest) for item in items]


def _alone(parts: Iterable[JobPart]) -> Iterator[Any]:
    """Compute the items of all parts of a job in this process, and yield their results in order."""
    chunker = _Chunker(parts, None, _SECONDS_ALONE)
    while (task := chunker.next_task(1)) is not None:
        results, seconds = _do(task.part.function, task.shared, task.part.items[task.begin : task.end]) or ([], 0.0)
        chunker.record(len(results), seconds)
        yield from results


class _Chunker:
    """Divides the items of job parts into tasks (ranges of items) of a target duration.

    `parts`: the `JobPart` objects; `folder`: folder for the files of shared data, None if the workers are threads;
    `seconds`: target duration of a task.
    """

    def __init__(self, parts: Iterable[JobPart], folder: Path | None, seconds: float = _SECONDS) -> None:
        self._parts, self._folder, self._seconds = iter(parts), folder, seconds
        self._part: JobPart | None = None
        self._shared: Any = None
        self._begin = self._number = 0
        self._size = 1

    def next_task(self, window: int) -> _Task | None:
        """Return the next task, or None after the last one.

        `window`: number of tasks that are submitted at the same time.  A task has at most 1 / `window` of the remaining
        items of the part, so that tasks become smaller and all workers finish at about the same time.
        """
        while self._part is None or self._begin >= len(self._part.items):
            self._part = next(self._parts, None)
            if self._part is None:
                return None
            self._begin = 0
            if len(self._part.items):
                self._shared = self._part.shared if self._folder is None else packed(self._part.shared, self._folder)
        remaining = len(self._part.items) - self._begin
        end = self._begin + min(self._size, -(-remaining // window))
        task = _Task(self._part, self._shared, self._begin, end, self._number)
        self._begin, self._number = end, self._number + end - task.begin
        return task

    def record(self, items: int, seconds: float) -> None:
        """Adapt the number of items per task to a measurement: `items` items were computed in `seconds` seconds."""
        fits = int(items * self._seconds / max(seconds, 1e-6))
        self._size = max(1, min(fits, 2 * max(items, self._size)))


class _Scheduler:
    """Submits tasks to an executor, and stores results until all earlier results are known.

    `executor`: executor of the caller; `chunker`: forms the tasks.
    """

    def __init__(self, executor: Executor, chunker: _Chunker) -> None:
        self._executor, self._is_own, self._chunker = executor, False, chunker
        self._window, self._had_workers = _FIRST_WINDOW, False
        self._submitted: dict[Future[Any], _Task] = {}
        self._finished: queue.SimpleQueue[Future[Any] | None] = queue.SimpleQueue()  # None: an interrupt
        self._retries: deque[_Task] = deque()
        self._early: dict[int, Results | Exception] = {}

    def results(self) -> Iterator[Any]:
        """Yield the results of all items in the order of the items; raise the exception of a task at its position."""
        due = 0
        while self._advance():
            while due in self._early:
                found = self._early.pop(due)
                if isinstance(found, Exception):
                    raise found
                due += len(found)
                yield from found

    def _advance(self) -> bool:
        """Submit tasks and receive finished ones; return False if no task is left; then handle Ctrl-C and SIGTERM."""
        with interrupts_deferred(wake=lambda: self._finished.put(None)):
            if not self._fill():
                return False
            future = self._next_finished()
            while future is not None:
                if future in self._submitted:  # unless the pool broke in the meantime
                    self._receive(future)
                future = None if self._finished.empty() else self._finished.get()
        return True

    def _next_finished(self) -> Future[Any] | None:
        """Wait for a finished task, and return its future, or None after Ctrl-C or SIGTERM.

        Raise WorkerError if all workers of a dask scheduler have gone; wait for the first worker without a limit.
        """
        if not isinstance(self._executor, DaskExecutor):
            return self._finished.get()
        gone_since: float | None = None
        while True:
            with contextlib.suppress(queue.Empty):
                return self._finished.get(timeout=_SECONDS_BETWEEN_COUNTS)
            if self._executor.has_workers():
                self._had_workers, gone_since = True, None
                continue
            gone_since = gone_since or time.perf_counter()
            if self._had_workers and time.perf_counter() - gone_since > _SECONDS_WITHOUT_WORKERS:
                raise WorkerError(
                    f"all workers of the dask scheduler have gone, and none came in {_SECONDS_WITHOUT_WORKERS:g} s; "
                    "start workers (dask worker HOST:PORT), and continue the run from its checkpoint"
                )

    def _fill(self) -> bool:
        """Submit tasks until the window is full; return whether any submitted task is unfinished.

        The window is 1 if two workers have died during a task.
        """
        is_suspect = any(task.deaths >= _MAX_DEATHS - 1 for task in (*self._retries, *self._submitted.values()))
        window = 1 if is_suspect else self._window
        while len(self._submitted) < window:
            has_room = len(self._early) < _AHEAD * self._window
            if self._retries:
                task: _Task | None = self._retries.popleft()
            else:
                task = self._chunker.next_task(self._window) if has_room else None
            if task is None:
                break
            task.sent = time.perf_counter()
            try:
                items = task.part.items[task.begin : task.end]
                future = self._executor.submit(_do, task.part.function, task.shared, items)
            except BrokenExecutor as error:
                self._retries.appendleft(task)
                self._renew(error)
            else:
                self._submitted[future] = task
                future.add_done_callback(self._finished.put)
        return bool(self._submitted)

    def _receive(self, future: Future[Any]) -> None:
        """Store the result or exception of a finished task, or schedule the task again if its worker failed."""
        self._had_workers = True
        task = self._submitted.pop(future)
        error = CancelledError() if future.cancelled() else future.exception()
        if error is None and (answer := future.result()) is None:
            task.shared = replace(task.shared, data=Path(task.shared.path).read_bytes())
            self._retries.append(task)
        elif error is None:
            results, seconds = answer
            # A task that did not wait in the queue shows that workers are idle: enlarge the window.
            if time.perf_counter() - task.sent < 2 * seconds:
                self._window = min(self._window + 1, _MAX_WINDOW)
            self._chunker.record(len(results), seconds)
            self._early[task.number] = results
        elif isinstance(error, BrokenExecutor):
            self._retry(task, error)
            self._renew(error)
        elif type(error).__name__ in _LOST or is_lost_by_dask(error):
            self._retry(task, error)
        elif type(error).__name__ == "KilledWorker":  # dask has already retried the task
            task.deaths = max(task.deaths, _MAX_DEATHS - 2)
            self._retry(task, error)
        elif isinstance(error, CancelledError):
            raise _executor_failed(self._executor, "it was closed, or lost its scheduler") from error
        else:
            self._early[task.number] = error if isinstance(error, Exception) else WorkerError(repr(error))

    def _retry(self, task: _Task, error: BaseException) -> None:
        """Schedule a task again after the death of its worker (`error`); raise WorkerError at the third death."""
        task.deaths += 1
        if task.deaths >= _MAX_DEATHS:
            raise _task_failed(task, error)
        self._retries.append(task)
        self._retries = deque(sorted(self._retries, key=lambda task: task.number))

    def _renew(self, error: BaseException) -> None:
        """Replace a pool that broke (exception `error`) and retry its tasks; raise WorkerError for other executors."""
        wait(self._submitted)
        for future in list(self._submitted):
            if future.done() and future.exception() is not None and isinstance(future.exception(), BrokenExecutor):
                self._retry(self._submitted.pop(future), error)
        pool = renewed(self._executor)
        if pool is None:
            raise _executor_failed(self._executor, error) from error
        self._shut_down()
        self._executor, self._is_own = pool, True

    def _shut_down(self) -> None:
        """Shut down a pool that this scheduler has created; leave the executor of the caller open."""
        if self._is_own:
            self._executor.shutdown(wait=False)

    def close(self) -> None:
        """Cancel the submitted tasks that have not started, and shut down a pool that this scheduler has created."""
        with interrupts_deferred():
            for future in self._submitted:
                with contextlib.suppress(NotImplementedError):  # parsl cannot cancel tasks
                    future.cancel()
            self._shut_down()


def _executor_failed(executor: Executor, reason: object) -> WorkerError:
    """Return the WorkerError for a broken executor that cannot be replaced; `reason`: cause, for the message."""
    return WorkerError(
        f"the executor broke ({reason}), and a {type(executor).__name__} cannot be restarted; create another executor "
        "and continue the run from its checkpoint"
    )


def _task_failed(task: _Task, error: BaseException) -> WorkerError:
    """Return the WorkerError for a task during which several workers died; `error`: report of the last death."""
    return WorkerError(
        f"workers died repeatedly while computing {task.place} ({type(error).__name__}), probably for lack of memory; "
        "use fewer workers or a coarser grid (in a script, create processes below if __name__ == '__main__')"
    )


def _do(function: Callable[[Any, Any], Results], shared: Any, items: Results) -> tuple[Results, float] | None:
    """In a worker: return the results of a task and their duration in seconds, or None if shared data are unreadable.

    `function`: called as ``function(shared, items)``, returns one result per item; `shared`: argument that is common to
    all items, as a `SharedData` (the name of a file) or the object itself; `items`: arguments of the task.
    """
    if isinstance(shared, SharedData):
        try:
            shared = unpacked(shared)
        except OSError:
            return None
    begin = time.perf_counter()
    results = function(shared, items)
    return results, time.perf_counter() - begin
