"""Monitor a running solve: number of iterations, progress, accuracy of its answer; and cancel it."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable

from resgrid.errors import InputError

Progress = Callable[[int, float, float | None], None]
"""Function that is called after every iteration, with three arguments.

They are the number of iterations so far, the residual norm relative to its start value, and the estimated seconds until
the target norm (None while the residual does not fall). Start and target are those of the present refinement step.
"""


class Stopped(Exception):  # noqa: N818 - not an error
    """Exception that ends a cancelled solve."""


class ProgressMonitor:
    """Iterations and accuracy of a solve, for one or several threads.

    Parameters
    ----------
    progress : Progress, optional
        Function that is called after every iteration, with the number of iterations, the residual norm relative to its
        start value, and the estimated seconds to the end; None by default.

    Attributes
    ----------
    iterations : int
        Iterations, summed over all right-hand sides and steps of iterative refinement; 0 for a direct method.
    error : float
        Largest backward error of a solution, normwise or componentwise as requested; 0 until there is a solution.
    bound : float
        Largest bound on the relative error of the entries of a solution, infinite without a proved bound; 0 until there
        is a solution.
    """

    def __init__(self, progress: Progress | None = None) -> None:
        if not (progress is None or callable(progress)):
            raise InputError(f"progress = {progress!r} must be a function of (iterations, residual, seconds), or None")
        self.iterations = 0
        self.error = self.bound = 0.0
        self._progress = progress
        self._stopped = False
        self._lock = threading.Lock()
        self._pass = threading.local()

    def begin(self, residual: float, goal: float) -> None:
        """Start a sequence of iterations; `residual`: residual norm at the start; `goal`: norm at which it ends.

        Both are in one unit, which the calls of `step` keep.
        """
        here = self._pass
        here.start, here.goal, here.since = residual, goal, time.perf_counter()

    def step(self, residual: float) -> None:
        """Record one iteration, and call the progress function.

        Parameters
        ----------
        residual : float
            Residual norm after the iteration, in the unit of the arguments of `begin`.

        Raises
        ------
        Stopped
            If the solve was cancelled.
        """
        if self._stopped:
            raise Stopped
        with self._lock:
            self.iterations += 1
        if self._progress is not None:
            self._progress(self.iterations, residual / (self._pass.start or 1.0), self._seconds_left(residual))

    def done(self, error: float, bound: float = math.inf) -> None:
        """Record the accuracy of a solution; keep the largest error and the largest bound of all solutions.

        Parameters
        ----------
        error : float
            Backward error, normwise or componentwise as requested.
        bound : float, optional
            Bound on the relative error of every entry, infinite by default.
        """
        with self._lock:
            if not (error <= self.error or math.isnan(self.error)):
                self.error = error
            self.bound = max(self.bound, bound)

    def stop(self) -> None:
        """Cancel the solve: the next call of `step` raises Stopped."""
        self._stopped = True

    def _seconds_left(self, residual: float) -> float | None:
        """Return the estimated seconds until the iterations reach their target; None while the residual does not fall.

        `residual`: present residual norm. The estimate assumes a constant convergence factor. The result is 0 at or
        below the target, and None if the target is 0.
        """
        here = self._pass
        if residual <= here.goal:
            return 0.0
        if not (here.goal > 0.0 and residual < here.start):
            return None
        elapsed = time.perf_counter() - here.since
        return float(elapsed * math.log(residual / here.goal) / math.log(here.start / residual))
