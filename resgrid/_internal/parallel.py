"""Work shared among the workers of any executor: results in their order, whoever does what, and whoever dies.

Items are cut into tasks of about a second, a window of which is kept in flight that is as wide as the workers need.
What the items share goes to every worker once: a task names it by its hash, and a worker that has not seen it reads it
from a file, or, where there is no such file, says so and is sent the task again with all it needs.
"""

from __future__ import annotations

import contextlib
import hashlib
import pickle
import tempfile
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ThreadPoolExecutor,
    wait,
)
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from resgrid._internal.executors import renewed
from resgrid.errors import InputError, WorkerError

_SECONDS = 1.0
"""That a task is to take in a worker."""

_SECONDS_ALONE = 0.2
"""That a task is to take where nobody shares the work, so that little is done in vain when it ends early."""

_FEWEST, _MOST = 4, 4096
"""Tasks in flight, to begin with and at most."""

_AHEAD = 16
"""Windows that results may be ahead of the first one missing."""

_STRIKES = 3
"""Deaths of workers after which a task is blamed; from the last but one on it is tried alone."""

_LOST = frozenset({"WorkerLost", "ManagerLost"})
"""What parsl calls a worker that died."""


Results = Sequence[Any] | NDArray[Any]


@dataclass(frozen=True, eq=False)
class JobPart:
    """Items that one function works on: ``function(shared, items)`` gives a result for each.

    `items` can be cut (a range, a list, rows of an array); `name`: what messages call them.
    """

    function: Callable[[Any, Any], Results]
    shared: Any
    items: Results
    name: str = "items"


@dataclass(frozen=True)
class _SharedData:
    """What items share, by its hash: in a file that a worker may see, and at need with its bytes."""

    digest: str
    path: str = field(compare=False)
    data: bytes | None = field(default=None, compare=False, repr=False)


@dataclass(eq=False)
class _Task:
    """Some items: results begin at `number` of all; `shared` is a parcel, or the value itself for threads."""

    part: JobPart
    shared: Any
    begin: int
    end: int
    number: int
    strikes: int = 0
    sent: float = 0.0

    @property
    def place(self) -> str:
        """The items, for messages."""
        items = self.part.items[self.begin : self.end]
        first, last = (items[0], items[-1]) if isinstance(items, range) else (self.begin, self.end - 1)
        return f"{self.part.name} {first} to {last}"


def in_order(parts: Iterable[JobPart], executor: Executor | None = None) -> Generator[Any, None, None]:
    """Results of all items, part by part, in their order.

    They do not depend on the executor, its workers, or the order in which these finish.  A pool of processes that broke
    is made anew, and what it was at is done again.  Close the iterator (`contextlib.closing`) to stop early: what has
    not begun is cancelled.  An error of an item is raised in its turn.

    Raises
    ------
    WorkerError
        If workers die over the same items again and again, or an executor broke that cannot be made anew.
    """
    if executor is None:
        yield from _alone(parts)
        return
    with tempfile.TemporaryDirectory(prefix="resgrid-") as folder:
        crew = _Scheduler(executor, _Chunker(parts, None if isinstance(executor, ThreadPoolExecutor) else Path(folder)))
        try:
            yield from crew.results()
        finally:
            crew.close()


def spread(
    function: Callable[..., Any], items: Iterable[Any], *shared: Any, executor: Executor | None = None
) -> Iterator[Any]:
    """Call a function for many items, such as scenes or starts, on the workers of an executor.

    Parameters
    ----------
    function : callable
        Called as ``function(item, *shared)``; workers that are processes import it by its name.
    items : iterable
        Anything that can be pickled.
    *shared
        What all calls need; sent to every worker once.
    executor : concurrent.futures.Executor, optional
        Where the work is done; by default here, one item after the other.

    Returns
    -------
    iterator
        What the calls return, in the order of the items, as soon as it is known.

    Raises
    ------
    InputError
        If `shared` cannot be pickled.
    WorkerError
        If a worker dies again and again over the same items.

    Examples
    --------
    >>> from concurrent.futures import ThreadPoolExecutor
    >>> with ThreadPoolExecutor(2) as threads:
    ...     list(rg.spread(pow, [1, 2, 3], 2, executor=threads))
    [1, 4, 9]
    """
    return in_order([JobPart(_call_each, (function, shared), list(items))], executor)


def _call_each(shared: tuple[Callable[..., Any], tuple[Any, ...]], items: Sequence[Any]) -> list[Any]:
    function, rest = shared
    return [function(item, *rest) for item in items]


def _alone(parts: Iterable[JobPart]) -> Iterator[Any]:
    cutter = _Chunker(parts, None, _SECONDS_ALONE)
    while (task := cutter.cut(1)) is not None:
        results, seconds = _do(task.part.function, task.shared, task.part.items[task.begin : task.end]) or ([], 0.0)
        cutter.learn(len(results), seconds)
        yield from results


class _Chunker:
    """Cuts parts into tasks of about so many seconds, and packs what their items share into files of a folder."""

    def __init__(self, parts: Iterable[JobPart], folder: Path | None, seconds: float = _SECONDS) -> None:
        self._parts, self._folder, self._seconds = iter(parts), folder, seconds
        self._part: JobPart | None = None
        self._shared: Any = None
        self._begin = self._number = 0
        self._size = 1

    def cut(self, window: int) -> _Task | None:
        """The next task; towards the end of a part they get smaller, so that all workers end at about the same time."""
        while self._part is None or self._begin >= len(self._part.items):
            self._part = next(self._parts, None)
            if self._part is None:
                return None
            self._begin = 0
            if len(self._part.items):
                self._shared = self._part.shared if self._folder is None else _packed(self._part.shared, self._folder)
        left = len(self._part.items) - self._begin
        end = self._begin + min(self._size, -(-left // window))
        task = _Task(self._part, self._shared, self._begin, end, self._number)
        self._begin, self._number = end, self._number + end - task.begin
        return task

    def learn(self, items: int, seconds: float) -> None:
        """How long some items took."""
        fits = int(items * self._seconds / max(seconds, 1e-6))
        self._size = max(1, min(fits, 2 * max(items, self._size)))


class _Scheduler:
    """The tasks in flight of an executor, and the results that came before their turn."""

    def __init__(self, executor: Executor, cutter: _Chunker) -> None:
        self._executor, self._own, self._cutter = executor, False, cutter
        self._window = _FEWEST
        self._flying: dict[Future[Any], _Task] = {}
        self._again: deque[_Task] = deque()
        self._early: dict[int, Results | Exception] = {}

    def results(self) -> Iterator[Any]:
        """All results in their order."""
        due = 0
        while self._fill():
            for future in wait(self._flying, return_when=FIRST_COMPLETED).done:
                if future in self._flying:  # not when its pool broke meanwhile
                    self._receive(future)
            while due in self._early:
                found = self._early.pop(due)
                if isinstance(found, Exception):
                    raise found
                due += len(found)
                yield from found

    def _fill(self) -> bool:
        """Send tasks until the window is full; whether any is in flight."""
        suspects = any(task.strikes >= _STRIKES - 1 for task in (*self._again, *self._flying.values()))
        window = 1 if suspects else self._window
        while len(self._flying) < window:
            fresh = not self._again and len(self._early) < _AHEAD * self._window
            task = self._again.popleft() if self._again else self._cutter.cut(self._window) if fresh else None
            if task is None:
                break
            task.sent = time.perf_counter()
            try:
                items = task.part.items[task.begin : task.end]
                future = self._executor.submit(_do, task.part.function, task.shared, items)
            except BrokenExecutor as error:
                self._again.appendleft(task)
                self._renew(error)
            else:
                self._flying[future] = task
        return bool(self._flying)

    def _receive(self, future: Future[Any]) -> None:
        task = self._flying.pop(future)
        error = CancelledError() if future.cancelled() else future.exception()
        if error is None and (answer := future.result()) is None:
            task.shared = replace(task.shared, data=Path(task.shared.path).read_bytes())
            self._again.append(task)
        elif error is None:
            results, seconds = answer
            # A task that did not wait for its worker says that the window is too narrow.
            if time.perf_counter() - task.sent < 2 * seconds:
                self._window = min(self._window + 1, _MOST)
            self._cutter.learn(len(results), seconds)
            self._early[task.number] = results
        elif isinstance(error, BrokenExecutor):
            self._blame(task, error)
            self._renew(error)
        elif type(error).__name__ in _LOST or _is_lost_by_dask(error):
            self._blame(task, error)
        elif type(error).__name__ == "KilledWorker":  # of all that waited on workers that died: dask tried again itself
            task.strikes = max(task.strikes, _STRIKES - 2)
            self._blame(task, error)
        elif isinstance(error, CancelledError):
            raise _given_up(self._executor, "it was closed, or lost its scheduler") from error
        else:
            self._early[task.number] = error if isinstance(error, Exception) else WorkerError(repr(error))

    def _blame(self, task: _Task, error: BaseException) -> None:
        task.strikes += 1
        if task.strikes >= _STRIKES:
            raise _guilty(task, error)
        self._again.append(task)
        self._again = deque(sorted(self._again, key=lambda task: task.number))

    def _renew(self, error: BaseException) -> None:
        """Make a broken pool anew; what it was at is to be done again."""
        wait(self._flying)
        for future in list(self._flying):
            if future.done() and future.exception() is not None and isinstance(future.exception(), BrokenExecutor):
                self._blame(self._flying.pop(future), error)
        fresh = renewed(self._executor)
        if fresh is None:
            raise _given_up(self._executor, error) from error
        self._shut()
        self._executor, self._own = fresh, True

    def _shut(self) -> None:
        if self._own:
            self._executor.shutdown(wait=False)

    def close(self) -> None:
        """Cancel what has not begun."""
        for future in self._flying:
            with contextlib.suppress(NotImplementedError):  # parsl's do not know how
                future.cancel()
        self._shut()


def _is_lost_by_dask(error: BaseException) -> bool:
    """Return whether dask forgot a task while it fetched the result: it then unpacks an answer that holds none."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    place = "" if trace is None else trace.tb_frame.f_globals.get("__name__", "")
    return isinstance(error, ValueError) and "to unpack" in str(error) and place == "distributed.cfexecutor"


def _given_up(executor: Executor, why: object) -> WorkerError:
    return WorkerError(
        f"the executor broke ({why}), and {type(executor).__name__} cannot be made anew; make another, and take the "
        "run up from its checkpoint"
    )


def _guilty(task: _Task, error: BaseException) -> WorkerError:
    return WorkerError(
        f"workers died again and again over {task.place} ({type(error).__name__}): most often memory is short; use "
        "fewer workers or a coarser grid (in a script, make processes below if __name__ == '__main__')"
    )


def _packed(shared: Any, folder: Path) -> _SharedData:
    """Pickle what items share into a file of a folder."""
    try:
        data = pickle.dumps(shared, protocol=5)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise InputError(f"what all items share cannot be sent to workers: {error}; use threads") from error
    digest = hashlib.sha256(data).hexdigest()
    path = folder / digest
    path.write_bytes(data)
    return _SharedData(digest, str(path))


@lru_cache(maxsize=4)
def _unpacked(parcel: _SharedData) -> Any:
    """The value in a parcel, kept by the worker; FileNotFoundError if it is not to be had here."""
    return pickle.loads(Path(parcel.path).read_bytes() if parcel.data is None else parcel.data)


def _do(function: Callable[[Any, Any], Results], shared: Any, items: Results) -> tuple[Results, float] | None:
    """In a worker: results and the seconds they took; None where it has not got what the items share."""
    if isinstance(shared, _SharedData):
        try:
            shared = _unpacked(shared)
        except OSError:
            return None
    begin = time.perf_counter()
    results = function(shared, items)
    return results, time.perf_counter() - begin
