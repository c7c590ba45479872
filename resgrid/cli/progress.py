"""A bar with the time left, on a terminal, for whatever takes more than a second."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

PATIENCE = 1.0
"""Seconds before a bar appears."""

_REFRESH = 0.2


class Progress:
    """How far a stage is: by steps counted, or by the time it was estimated to take.

    `seconds`: estimate of the time the whole stage takes; `steps`: number of equal steps; counts more than the
    estimate.
    """

    def __init__(self, seconds: float | None = None, steps: int | None = None) -> None:
        self._seconds = seconds
        self._steps = steps
        self._done = 0
        self._note = ""
        self._left: float | None = None
        self._begin = time.perf_counter()

    def advance(self) -> None:
        """One more step is done."""
        self._done += 1

    def tell(self, done: int, total: int) -> None:
        """Told by the library itself: ``done`` of ``total`` steps."""
        self._done, self._steps = done, total

    def note(self, text: str) -> None:
        """What is known so far, for people."""
        self._note = text

    def follow(self, _steps: int, residual: float, seconds_left: float | None) -> None:
        """Told by an iteration: how small its residual is, and about how long it still takes."""
        self._note, self._left = f"residual {residual:.0e}", seconds_left

    def told(self) -> str:
        """What is known so far, and the time left."""
        return f"{self._note}  {self.time_left()}" if self._note else self.time_left()

    def fraction(self) -> float | None:
        """Part of the stage that is done, in [0, 0.99]; None where nobody knows."""
        if self._steps:
            return min(self._done / self._steps, 0.99)
        if self._left is not None:
            return min(self._elapsed() / (self._elapsed() + self._left), 0.99)
        return min(self._elapsed() / self._seconds, 0.99) if self._seconds else None

    def time_left(self) -> str:
        """The time left, for people."""
        fraction, elapsed = self.fraction(), self._elapsed()
        if not fraction:
            return f"{elapsed:.0f} s so far"
        if self._steps:
            return f"about {elapsed * (1 - fraction) / fraction:.0f} s left"
        left = (self._seconds or 0.0) - elapsed if self._left is None else self._left
        return f"about {left:.0f} s left" if left > 0 else f"{elapsed:.0f} s so far, longer than expected"

    def _elapsed(self) -> float:
        return time.perf_counter() - self._begin


@contextmanager
def progress_bar(
    name: str, *, seconds: float | None = None, steps: int | None = None, hidden: bool = False
) -> Iterator[Progress]:
    """Show a bar on standard error while the block runs, if it is a terminal and the block takes long."""
    progress = Progress(seconds, steps)
    if hidden or not sys.stderr.isatty():
        yield progress
        return
    finished = threading.Event()
    painter = threading.Thread(target=_paint, args=(name, progress, finished), daemon=True)
    painter.start()
    try:
        yield progress
    finally:
        finished.set()
        painter.join()


def _paint(name: str, progress: Progress, finished: threading.Event) -> None:
    if finished.wait(PATIENCE):
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress as Bar, TextColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[left]}"))
    with Bar(*columns, console=Console(stderr=True), transient=True, auto_refresh=False) as bar:
        task = bar.add_task(name, total=None, left="")
        while not finished.wait(_REFRESH):
            fraction = progress.fraction()
            total = None if fraction is None else 1.0
            bar.update(task, total=total, completed=fraction or 0.0, left=progress.told(), refresh=True)
