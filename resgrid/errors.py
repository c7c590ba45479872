"""Everything that resgrid raises on purpose.

A message says what is wrong, where (file, line, key, cell), and what to do about it.  The command line turns each
class into an exit code; the library never exits.
"""

from __future__ import annotations


class ResgridError(Exception):
    """Base class of every error that resgrid raises on purpose."""


class InputError(ResgridError):
    """A file, key, value or argument is wrong; the message names it and the remedy."""


class CircuitError(ResgridError):
    """The netlist has no operating point: nothing drives it, or its sources contradict each other."""


class AccuracyError(ResgridError):
    """An answer was computed but does not keep the promised accuracy.

    Attributes
    ----------
    best : object or None
        The best answer there was, for inspection only.
    """

    def __init__(self, message: str, best: object | None = None) -> None:
        super().__init__(message)
        self.best = best


class CertificateError(ResgridError):
    """A streamline breaks one of its promises; the message names the step and the promise."""


class ToolMissingError(ResgridError):
    """An outside program (a circuit simulator) is not installed; the message says how to get it."""


class BudgetError(ResgridError):
    """The job would not fit in the memory or time allowed; the message holds the estimate."""


class WorkerError(ResgridError):
    """Workers of an executor died again and again over the same work, which the message names."""
