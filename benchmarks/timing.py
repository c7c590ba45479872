"""Time jobs in turn, so that whatever else the machine does falls on all of them alike."""

from __future__ import annotations

import resource
import statistics
import time
from collections.abc import Callable, Sequence

from benchmarks.rows import Spread

Job = Callable[[], object]


def spread(values: Sequence[float]) -> Spread:
    """Median and range."""
    return Spread(statistics.median(values), min(values), max(values))


def timed(job: Job) -> float:
    """Seconds that a job takes."""
    start = time.perf_counter()
    job()
    return time.perf_counter() - start


def busy(job: Job) -> float:
    """Seconds of processor time that a job takes, with the processes that it has waited for."""
    start = _processor_time()
    job()
    return _processor_time() - start


def _processor_time() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def alternating(first: Job, second: Job, rounds: int) -> tuple[Spread, Spread, Spread]:
    """Times of both jobs, and of the first divided by the second, round by round."""
    pairs = [(timed(first), timed(second)) for _ in range(rounds)]
    return (
        spread([pair[0] for pair in pairs]),
        spread([pair[1] for pair in pairs]),
        spread([pair[0] / pair[1] for pair in pairs]),
    )


def repeated(job: Job, times: int = 10) -> Job:
    """A job done several times over."""

    def run() -> None:
        for _ in range(times):
            job()

    return run


def scaled(value: Spread, factor: float) -> Spread:
    """A spread in other units."""
    return Spread(value.median * factor, value.low * factor, value.high * factor)
