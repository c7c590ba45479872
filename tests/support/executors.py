"""Faulty executors, and functions for the workers of real executors."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import random
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest


class Shuffled(Executor):
    """Executor that finishes tasks in any order; arguments and results are pickled, `sizes` holds their bytes.

    `remote`: the worker has no access to the files of this computer.
    """

    def __init__(self, seed: int, *, remote: bool = False) -> None:
        self._draw, self._remote = random.Random(seed), remote
        self._tasks: list[tuple[Future[Any], bytes]] = []
        self._some = threading.Condition()
        self._open = True
        self.sizes: list[int] = []
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        data = pickle.dumps((fn, args, kwargs))
        self.sizes.append(len(data))
        future: Future[Any] = Future()
        with self._some:
            self._tasks.append((future, data))
            self._some.notify()
        return future

    def _work(self) -> None:
        while True:
            with self._some:
                self._some.wait_for(lambda: self._tasks or not self._open)
                if not self._tasks:
                    return
                future, data = self._tasks.pop(self._draw.randrange(len(self._tasks)))
            if not future.set_running_or_notify_cancel():
                continue
            function, words, options = pickle.loads(data)
            if self._remote:
                words = [replace(word, path="/nowhere") if hasattr(word, "digest") else word for word in words]
            try:
                future.set_result(pickle.loads(pickle.dumps(function(*words, **options))))
            except Exception as error:
                future.set_exception(error)

    def shutdown(self, wait: bool = True, **_options: Any) -> None:
        with self._some:
            self._open = False
            self._some.notify()
        if wait:
            self._thread.join()


@contextmanager
def two_workers(kind: str, folder: Path) -> Iterator[Executor]:
    """Return an executor with two processes as workers; `folder`: folder of its files."""
    from benchmarks.executors import opened  # not in workers, which import this file

    with pytest.MonkeyPatch.context() as patch:  # as in an activated environment
        patch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
        if kind == "forkserver":
            with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("forkserver")) as executor:
                yield executor
        else:
            with opened(kind, 2, folder) as executor:
                assert executor is not None
                yield executor


def sums(shared: Any, items: Sequence[int]) -> list[int]:
    """Return the sum of every item and the common number."""
    return [shared["offset"] + item for item in items]


def slow_sums(shared: Any, items: Sequence[int]) -> list[int]:
    """Return the sums; every item takes a hundredth of a second."""
    time.sleep(0.01 * len(items))
    return sums(shared, items)


def dying_sums(shared: Any, items: Sequence[int]) -> list[int]:
    """Return the sums; the first worker that processes item 7 dies."""
    with contextlib.suppress(FileExistsError):
        if 7 in items:
            Path(shared["mark"]).touch(exist_ok=False)
            os.kill(os.getpid(), signal.SIGKILL)
    return sums(shared, items)


def deadly_sums(shared: Any, items: Sequence[int]) -> list[int]:
    """Return the sums; every worker that processes item 7 dies."""
    if 7 in items:
        os.kill(os.getpid(), signal.SIGKILL)
    return sums(shared, items)


def failing_sums(shared: Any, items: Sequence[int]) -> list[int]:
    """Return the sums; raise an error for item 7."""
    if 7 in items:
        raise ValueError("item 7 cannot be done")
    return sums(shared, items)


def squared(item: int, *more: int) -> int:
    """Return the square of one item."""
    return item * item + sum(more)
