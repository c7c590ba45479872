"""Rows of a section, and the scale of its problems."""

from __future__ import annotations

from dataclasses import dataclass

RATIO = "x resgrid"
"""Unit of a row that compares a contender's time with resgrid's: 3 means three times as long."""


@dataclass(frozen=True)
class Scale:
    """Scale of a run.

    Attributes
    ----------
    name : {"tiny", "quick", "full"}
        ``"tiny"`` is for tests.
    rounds : int
        Maximum number of alternating runs of one comparison.
    limit : float
        Time limit of one run of one contender, in seconds.
    seed : int
        Added to the seed of every problem, to measure problems that were not used for tuning.
    """

    name: str = "quick"
    rounds: int = 5
    limit: float = 60.0
    seed: int = 0

    @property
    def full(self) -> bool:
        """Return whether large sizes are included."""
        return self.name == "full"


@dataclass(frozen=True)
class Spread:
    """Median, smallest and largest value of measurements."""

    median: float
    low: float
    high: float


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Attributes
    ----------
    name : str
        The problem or the job.
    seconds : float or None
        Median wall-clock time; None if the run did not finish or the row is not a time.
    value : Spread or None
        Value in `unit`; None if there is no value, with the reason in `note`.
    unit : str
        ``RATIO``, ``"products"``, ``"bytes/unknown"``, ...
    contender : str
        The contender that was measured.
    note : str
        Further information: chosen method, number of runs, reason for a failure.
    """

    name: str
    seconds: float | None
    value: Spread | None
    unit: str
    contender: str = "resgrid"
    note: str = ""
