"""Figures of merit with unit and definition, their tables, the base class of results, and fractions with intervals.

Fractions of trials have score intervals (Wilson 1927), also for clusters of correlated trials (Kish 1965).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.values import lock, picture_of
from resgrid.scene.quantities import format_quantity

_UNITS = {"ohm": "Ω", "V/sqrt(Hz)": "V/√Hz"}


@dataclass(frozen=True)
class Figure:
    """One figure of merit.

    A value of the mapping ``figures`` of every result of `resgrid.chip.Study`; ``str`` gives the value with its unit.

    Attributes
    ----------
    value : float, int, str or None
        The value, in `unit`; None where the figure is undefined.
    unit : str
        SI unit; ``""`` for a pure number.
    definition : str
        Definition of the figure, as a phrase.

    Examples
    --------
    >>> figure = rg.study(rg.read_scene("examples/scenes/lesson.toml")).power().figures["power"]
    >>> print(figure)
    246.2 µW
    >>> f"{figure.value:.3e}", figure.unit, figure.definition
    ('2.462e-04', 'W', 'heat in all resistors at the operating point')
    """

    value: float | int | str | None
    unit: str
    definition: str

    def __str__(self) -> str:
        return formatted(self.value, self.unit)


def formatted(value: float | int | str | None, unit: str) -> str:
    """Return a value with its unit as text, such as ``"38.12 µA"``: four significant digits and an SI prefix.

    `value`: number, text (returned unchanged), or None for an undefined value; `unit`: SI unit, ``""`` for a pure
    number.
    """
    if value is None:
        return "undefined"
    if isinstance(value, str):
        return value
    if unit in ("", "bit", "°C", "%"):
        return f"{value:,}" if isinstance(value, int) else f"{value:.4g}" + (f" {unit}" if unit else "")
    return format_quantity(value, _UNITS.get(unit, unit))


def table_lines(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Return the lines of a Markdown table.

    `head`: column titles; `rows`: texts of the columns, for every row.
    """
    return [f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *rows)]


def html_table(lines: Sequence[str]) -> str:
    """Return Markdown lines with a table as HTML text, for notebooks."""
    from markdown_it import MarkdownIt

    return str(MarkdownIt("commonmark", {"html": False}).enable("table").render("\n".join(lines)))


def figure_lines(figures: Mapping[str, Figure]) -> list[str]:
    """Return the lines of a Markdown table of figures of merit: name, value and definition.

    `figures`: figures by name; the names are the first column.
    """
    rows = (
        (name.replace("_", " "), str(figure), figure.definition.replace("|", "\\|")) for name, figure in figures.items()
    )
    return table_lines(("figure", "value", "definition"), rows)


class Result:
    """Base class of the results of analyses: frozen dataclasses with read-only arrays and figures of merit."""

    def __post_init__(self) -> None:
        lock(vars(self))

    @property
    def figures(self) -> Mapping[str, Figure]:
        """Figures of merit by name, with units and definitions."""
        raise NotImplementedError

    def to_json(self) -> dict[str, Any]:
        """Return the figures of merit as a dictionary for JSON, by name.

        Each value is a dictionary with the keys ``value`` (None if undefined), ``unit`` and ``definition``.
        """
        return {name: asdict(figure) for name, figure in self.figures.items()}

    def __repr__(self) -> str:
        figures = ", ".join(f"{name}: {figure}" for name, figure in self.figures.items())
        return f"{type(self).__name__}({figures})"

    def _repr_html_(self) -> str:
        return picture_of(self) + html_table(figure_lines(self.figures))


def defined(value: float) -> float | None:
    """Return a number as a float if it is finite, else None."""
    return float(value) if math.isfinite(value) else None


@dataclass(frozen=True)
class Proportion:
    """A fraction that was observed in trials (chips), with its confidence interval.

    The type of `Yield.overall`, `Yield.perfect`, `YieldLoss.overall` and `Cause.share`.  A yield is the fraction of all
    starts on all chips from which a robot reaches a goal, so that it is no multiple of 1 / `trials`; `Yield.perfect` is
    a fraction of the chips.

    Attributes
    ----------
    value, low, high : float
        The observed fraction, and the lower and upper ends of its confidence interval, each from 0 to 1.
    trials : int
        Number of trials (chips); 1 if all chips are equal.
    confidence : float
        Confidence of the interval, between 0 and 1.
    half_width : float
        Half the width of the interval.

    Examples
    --------
    >>> chip = rg.Chip(mismatch=0.02, readout=rg.chip.Readout(bits=8))
    >>> overall = rg.study(rg.read_scene("examples/scenes/lesson.toml"), chip).yields(trials=32).overall
    >>> print(overall)
    70.8 % (68.6 to 72.8 %)
    >>> overall.trials, round(overall.half_width, 3)
    (32, 0.021)
    """

    value: float
    low: float
    high: float
    trials: int
    confidence: float

    @property
    def half_width(self) -> float:
        """Half the width of the confidence interval, a fraction between 0 and 0.5."""
        return 0.5 * (self.high - self.low)

    def __str__(self) -> str:
        return f"{100 * self.value:.1f} % ({100 * self.low:.1f} to {100 * self.high:.1f} %)"


def proportion(
    share: float, trials: int, confidence: float, effective: float | None = None, *, random: bool
) -> Proportion:
    """Return a fraction that was observed in trials with its score interval (Wilson 1927), as a Proportion.

    `share`: observed fraction, 0 to 1; `trials`: number of trials (chips); `confidence`: confidence of the interval,
    between 0 and 1; `effective`: number of independent trials that would be as precise, which determines the width of
    the interval, None for `trials`; `random`: whether trials differ; if they do not, the interval has no width, and the
    number of trials in the result is 1.
    """
    if not random:
        return Proportion(share, share, share, 1, confidence)
    low, high = wilson(share, trials if effective is None else effective, confidence)
    return Proportion(share, min(float(low), share), max(float(high), share), trials, confidence)


def wilson(share: NDArray[np.float64] | float, trials: float, confidence: float) -> tuple[Any, Any]:
    """Return the lower and upper ends of the Wilson score interval of observed fractions, in the shape of `share`.

    `share`: observed fractions, 0 to 1; `trials`: number of independent trials; `confidence`: between 0 and 1.
    """
    z = NormalDist().inv_cdf(0.5 + 0.5 * confidence)
    weight = 1.0 + z * z / trials
    middle = (share + 0.5 * z * z / trials) / weight
    half = z / weight * np.sqrt(share * (1.0 - np.asarray(share)) / trials + 0.25 * (z / trials) ** 2)
    return np.maximum(middle - half, 0.0), np.minimum(middle + half, 1.0)


def effective_trials(counts: NDArray[np.int64], members: int) -> float:
    """Return the number of independent trials that are as precise as trials in clusters (Kish 1965).

    A cluster is a trial with several members that may be correlated, such as a chip and its starts.  The result is
    ``p (1 - p)`` over the variance of ``p``, the fraction of successes among the members of all clusters.  The variance
    is estimated from the spread between clusters.  The result is at least the number of clusters, and at most the
    number of members of all clusters.  For a single cluster, or equal counts, it is the number of clusters.

    `counts` (clusters,): number of successes in every cluster; `members`: number of members of each cluster.
    """
    total, squares, trials = int(counts.sum()), int(counts @ counts), len(counts)
    share = total / (trials * members)
    if trials < 2:
        return float(trials)
    # Integer arithmetic, so that equal counts give a variance of exactly 0.
    variance = (trials * squares - total * total) / (trials * trials * (trials - 1)) / members**2
    if variance <= 0.0:
        return float(trials)
    return float(min(max(share * (1.0 - share) / variance, trials), trials * members))
