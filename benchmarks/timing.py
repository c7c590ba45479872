"""Time jobs in turn, so that other load on the machine affects all jobs."""

from __future__ import annotations

import resource
import statistics
import time
from collections.abc import Callable, Sequence

from benchmarks.rows import Spread

Job = Callable[[], object]


def spread(values: Sequence[float]) -> Spread:
    """Return median and range."""
    return Spread(statistics.median(values), min(values), max(values))


def timed(job: Job) -> float:
    """Return the wall-clock seconds of a job."""
    start = time.perf_counter()
    job()
    return time.perf_counter() - start


def busy(job: Job) -> float:
    """Return the processor seconds of a job, including its finished child processes."""
    start = _processor_time()
    job()
    return _processor_time() - start


def _processor_time() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def alternating(first: Job, second: Job, rounds: int) -> tuple[Spread, Spread, Spread]:
    """Return the times of both jobs, and their ratio in every round."""
    pairs = [(timed(first), timed(second)) for _ in range(rounds)]
    return (
        spread([pair[0] for pair in pairs]),
        spread([pair[1] for pair in pairs]),
        spread([pair[0] / pair[1] for pair in pairs]),
    )


def repeated(job: Job, times: int = 10) -> Job:
    """Return a job that is repeated several times."""

    def run() -> None:
        for _ in range(times):
            job()

    return run


def scaled(value: Spread, factor: float) -> Spread:
    """Return a spread in other units."""
    return Spread(value.median * factor, value.low * factor, value.high * factor)
