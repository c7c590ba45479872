"""Threads that share the parts of a loop, and wait without spinning."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from functools import partial
from typing import Any, TypeVar

Result = TypeVar("Result")

_PIECE = 2**17
"""Length of the pieces of a long loop."""


class ThreadTeam:
    """A caller's thread and its helpers, which do the parts of a job side by side.

    Whoever is free takes the next part, so that nobody waits for a helper that the computer gives no core: its part is
    done by the caller then.  Several threads may call one team.

    `size`: threads, the caller's included.  It is a context, behind which the helpers end.
    """

    def __init__(self, size: int = 1) -> None:
        self.size = size
        self._pool = ThreadPoolExecutor(size - 1, thread_name_prefix="resgrid") if size > 1 else None

    def __enter__(self) -> ThreadTeam:
        """Return it."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the helpers, as soon as they are done with the part in their hands."""
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def share(self, part: Callable[[int], object], parts: int) -> None:
        """Do ``part(0) ... part(parts - 1)``, in any order; an error in one of them is raised, the rest left out."""
        if self._pool is None or parts < 2:
            for number in range(parts):
                part(number)
            return
        numbers = list(range(parts))
        left = iter(numbers)  # everybody's

        def work() -> None:
            for number in left:
                part(number)

        helpers = [self._pool.submit(work) for _ in range(min(self.size, parts) - 1)]
        try:
            work()
        except BaseException:
            numbers.clear()
            raise
        finally:
            wait([helper for helper in helpers if not helper.cancel()])
        for helper in helpers:
            if not helper.cancelled():
                helper.result()

    def together(self, jobs: Sequence[Callable[[], Any]]) -> list[Any]:
        """Do some jobs side by side; returns their results in their order."""
        results: list[Any] = [None] * len(jobs)

        def part(number: int) -> None:
            results[number] = jobs[number]()

        self.share(part, len(jobs))
        return results

    def over(self, count: int, loop: Callable[[slice], Result]) -> list[Result]:
        """Do a loop piece by piece; returns results of the same pieces whatever the number of threads."""
        pieces = [slice(k, min(k + _PIECE, count)) for k in range(0, count, _PIECE)]
        return self.together([partial(loop, piece) for piece in pieces])


ALONE = ThreadTeam()
"""The caller's thread."""
