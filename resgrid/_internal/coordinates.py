"""Coordinates and their ranges as text for messages."""

from __future__ import annotations

import math

_DIGITS = 6
"""Minimum number of significant digits to which the text of a coordinate is rounded."""

_MOST_DIGITS = 15
"""Maximum number of significant digits of the text of a coordinate: every decimal of 15 digits survives as a double."""


def coordinate_text(value: float, step: float = 1e-3) -> str:
    """Return a coordinate as text, rounded to six significant digits, or to more if six do not resolve `step`.

    `step`: difference that the text must show, in the unit of `value`.  Six digits resolve only 10 m at the coordinates
    of a national grid, such as 5400000 m.  Trailing zeros are omitted.
    """
    if value == 0 or not math.isfinite(value):
        return f"{value:g}"
    digits = math.floor(math.log10(abs(value))) - math.floor(math.log10(step)) + 1
    return f"{value:.{min(max(digits, _DIGITS), _MOST_DIGITS)}g}"


def span_text(lower: float, upper: float) -> str:
    """Return a range of coordinates as text, such as ``0 to 8``."""
    return f"{coordinate_text(lower)} to {coordinate_text(upper)}"


def interval_text(name: str, lower: float, upper: float) -> str:
    """Return the range of a coordinate as text, such as ``x in [0, 8]``."""
    return f"{name} in [{coordinate_text(lower)}, {coordinate_text(upper)}]"
