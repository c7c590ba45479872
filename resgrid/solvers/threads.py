"""`ThreadTeam`: threads that share the numbered parts of a job, and do not occupy a core while they wait."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from functools import partial
from typing import Any, TypeVar

Result = TypeVar("Result")

_PIECE = 2**17
"""Number of array entries in one slice of `ThreadTeam.over`; a thread that is free processes the next slice."""


class ThreadTeam:
    """The calling thread and helper threads, which run the parts of a job concurrently.

    A job is a function that is called for every part number. A free thread takes the next part. The calling thread
    takes the part of a helper that has no processor core, so that no thread waits for that helper. Several threads may
    use one team. As a context manager, the team ends its helpers on exit.

    Parameters
    ----------
    size : int, optional
        Number of threads, including the caller; 1 by default.
    """

    def __init__(self, size: int = 1) -> None:
        self.size = size
        self._pool = ThreadPoolExecutor(size - 1, thread_name_prefix="resgrid") if size > 1 else None

    def __enter__(self) -> ThreadTeam:
        """Return this team."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the helper threads as soon as their current parts are finished; suppress no exception of the context."""
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def run_parts(self, part: Callable[[int], object], parts: int) -> None:
        """Call ``part(0)`` to ``part(parts - 1)`` once each, in any order, and wait for all calls to end.

        An exception in any call cancels the calls that have not begun, and is raised here after the other calls have
        ended.
        """
        if self._pool is None or parts < 2:
            for number in range(parts):
                part(number)
            return
        numbers = list(range(parts))
        left = iter(numbers)  # shared by all threads

        def work() -> None:
            try:
                for number in left:
                    part(number)
            except BaseException:
                numbers.clear()
                raise

        helpers = [self._pool.submit(work) for _ in range(min(self.size, parts) - 1)]
        try:
            work()
        finally:
            wait([helper for helper in helpers if not helper.cancel()])
        for helper in helpers:
            if not helper.cancelled():
                helper.result()

    def together(self, jobs: Sequence[Callable[[], Any]]) -> list[Any]:
        """Call the functions `jobs` concurrently, and return the list of their results in the order of `jobs`."""
        results: list[Any] = [None] * len(jobs)

        def part(number: int) -> None:
            results[number] = jobs[number]()

        self.run_parts(part, len(jobs))
        return results

    def over(self, count: int, function: Callable[[slice], Result]) -> list[Result]:
        """Call `function` for slices of ``range(count)``, and return the list of its results in the order of slices.

        Every slice has 131,072 entries, except that the last one may have fewer. Slices do not depend on the number of
        threads.
        """
        pieces = [slice(k, min(k + _PIECE, count)) for k in range(0, count, _PIECE)]
        return self.together([partial(function, piece) for piece in pieces])


SINGLE_THREAD = ThreadTeam()
"""Team without helper threads: the calling thread does all work."""
