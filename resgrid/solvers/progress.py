"""Watching a solve from outside: how many steps it takes, how far it is, how accurate its answer is."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable

from resgrid.errors import InputError

Progress = Callable[[int, float, float | None], None]
"""Called after every step of an iteration: steps so far; residual norm relative to where the present pass began; and
about how many seconds that pass still takes (None where nothing is gained)."""


class Stopped(Exception):  # noqa: N818 - it is no error
    """The solve was told to end."""


class ProgressMonitor:
    """What a factor tells while it solves.

    Parameters
    ----------
    progress : Progress, optional
        Whom to tell.

    Attributes
    ----------
    iterations : int
        Steps of the iterative method, all right-hand sides and passes of refinement together; 0 without one.
    error : float
        Largest backward error of a solution, normwise or componentwise as promised; 0 until there is one.
    bound : float
        Largest bound on the relative error of the entries of a solution, infinite where none was proved; 0 until there
        is a solution.
    """

    def __init__(self, progress: Progress | None = None) -> None:
        if not (progress is None or callable(progress)):
            raise InputError(f"progress = {progress!r} must be callable, or None")
        self.iterations = 0
        self.error = self.bound = 0.0
        self._progress = progress
        self._stopped = False
        self._lock = threading.Lock()
        self._pass = threading.local()

    def begin(self, residual: float, goal: float) -> None:
        """A pass begins at a residual norm, and ends at another one."""
        here = self._pass
        here.start, here.goal, here.since = residual, goal, time.perf_counter()

    def step(self, residual: float) -> None:
        """One more step is done, and has brought the residual norm here.

        Raises
        ------
        Stopped
            If the solve was told to end.
        """
        if self._stopped:
            raise Stopped
        with self._lock:
            self.iterations += 1
        if self._progress is not None:
            self._progress(self.iterations, residual / (self._pass.start or 1.0), self._seconds_left(residual))

    def done(self, error: float, bound: float = math.inf) -> None:
        """A solution of this backward error is reached, none of whose entries is off by more than this bound."""
        with self._lock:
            if not (error <= self.error or math.isnan(self.error)):
                self.error = error
            self.bound = max(self.bound, bound)

    def stop(self) -> None:
        """End the solve at its next step."""
        self._stopped = True

    def _seconds_left(self, residual: float) -> float | None:
        here = self._pass
        if residual <= here.goal:
            return 0.0
        if not (here.goal > 0.0 and residual < here.start):
            return None
        elapsed = time.perf_counter() - here.since
        return float(elapsed * math.log(residual / here.goal) / math.log(here.start / residual))
