"""Run independent jobs at the same time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Value = TypeVar("Value")


def side_by_side(jobs: Sequence[Callable[[], Value]], threads: int, stop: Callable[[], None]) -> list[Value]:
    """Results of all jobs, in their order; with one thread one job after the other."""
    if threads <= 1 or len(jobs) <= 1:
        return [job() for job in jobs]
    with ThreadPoolExecutor(min(threads, len(jobs))) as pool:
        running = [pool.submit(job) for job in jobs]
        try:
            return [future.result() for future in running]
        except BaseException:
            stop()
            raise
