"""What a section returns, and how large its problems may be."""

from __future__ import annotations

from dataclasses import dataclass

RATIO = "x resgrid"
"""Unit of a row that compares a contender's time with resgrid's: 3 means three times as long."""


@dataclass(frozen=True)
class Scale:
    """How large a run is.

    Attributes
    ----------
    name : {"tiny", "quick", "full"}
        ``"tiny"`` is for tests.
    rounds : int
        Most alternating runs of one comparison.
    limit : float
        Seconds that one run of one contender may take.
    seed : int
        Added to the seed of every problem, so that figures can be taken on problems that nobody tuned for.
    """

    name: str = "quick"
    rounds: int = 5
    limit: float = 60.0
    seed: int = 0

    @property
    def full(self) -> bool:
        """Whether the large sizes are wanted."""
        return self.name == "full"


@dataclass(frozen=True)
class Spread:
    """Median, smallest and largest of some measurements."""

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
        Median wall-clock time; None where it did not finish or is no time.
    value : Spread or None
        What the row is about, in `unit`; None where there is none, and then `note` says why.
    unit : str
        ``RATIO``, ``"products"``, ``"bytes/unknown"``, ...
    contender : str
        Whose figure it is.
    note : str
        What else matters: the method chosen, the number of runs, why it failed.
    """

    name: str
    seconds: float | None
    value: Spread | None
    unit: str
    contender: str = "resgrid"
    note: str = ""
