"""Checks of numbers: annotated types with limits, and functions that raise InputError for a wrong number or array."""

from __future__ import annotations

import math
import sys
from numbers import Integral, Real
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Gt, Lt
from numpy.typing import ArrayLike, NDArray

from resgrid.errors import InputError

Positive = Annotated[float, Gt(0), Lt(math.inf)]
NotNegative = Annotated[float, Ge(0), Lt(math.inf)]
Between = Annotated[float, Gt(0), Lt(1)]
Count = Annotated[int, Ge(1)]
Natural = Annotated[int, Ge(0)]
"""Types of finite numbers: `Positive`: above 0; `NotNegative`: at least 0; `Between`: strictly between 0 and 1;
`Count`: integer of at least 1; `Natural`: integer of at least 0.
"""

_HUGE = sys.float_info.max


def is_number(value: Any) -> bool:
    """Return whether a value is a finite real number; True and False are not numbers here."""
    try:
        return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:  # an int beyond the range of doubles
        return False


def is_whole(value: Any) -> bool:
    """Return whether a value is an integer; True and False are not integers here."""
    return isinstance(value, Integral) and not isinstance(value, bool)


def check_number(
    name: str, value: Any, words: str, *, least: float = -math.inf, above: float = -math.inf, below: float = math.inf
) -> None:
    """Raise InputError unless a value is a finite real number within the limits.

    `name`: name of the value in the message; `words`: description of the limits in the message; `least`: smallest
    allowed value; `above`, `below`: exclusive limits.
    """
    if not (is_number(value) and value >= least and above < value < below):
        raise InputError(f"{name} = {value!r} must be {words}")


def check_fraction(name: str, value: Any) -> None:
    """Raise InputError unless a value is a number from 0 to 1; `name`: name of the value in the message."""
    if not (is_number(value) and 0 <= value <= 1):
        raise InputError(f"{name} = {value!r} must lie between 0 and 1")


def check_whole(name: str, value: Any, least: int) -> None:
    """Raise InputError unless a value is an integer of at least `least`; `name`: name of the value in the message."""
    if not (is_whole(value) and int(value) >= least):
        raise InputError(f"{name} = {value!r} must be a whole number, at least {least}")


def real_numbers(name: str, value: ArrayLike) -> NDArray[Any]:
    """Return a value as an array of real numbers; raise InputError for complex or masked numbers, text and dates.

    Integers, truth values and floats keep their data type; NaN and infinity are accepted. `name`: name of the value in
    the message.
    """
    try:
        array = np.asarray(value)
        if array.size and array.dtype.kind not in "biuf":
            array = array.astype(np.float64, casting="unsafe" if array.dtype.kind == "O" else "same_kind")
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{name} must be an array of real numbers") from None
    if value is None or np.ma.is_masked(value):
        raise InputError(f"{name} must be an array of real numbers, {'not None' if value is None else 'none masked'}")
    return array


def per_axis(
    name: str, value: ArrayLike, ndim: int, words: str, *, least: float = -_HUGE, above: float = -math.inf,
    most: float = _HUGE,
) -> NDArray[np.float64]:  # fmt: skip
    """Return one number per axis, (ndim,); raise InputError for a wrong shape or a number outside the limits.

    `name`: name of the value in the message; `value`: one number for all axes or one for each; `words`: description of
    the limits in the message; `least`, `most`: smallest and largest allowed number, by default every finite one;
    `above`: exclusive lower limit.
    """
    try:
        given = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        given = np.full(1, np.nan)
    if given.shape not in ((), (1,), (ndim,)) or not np.all((given >= least) & (given > above) & (given <= most)):
        raise InputError(f"{name} = {value!r} must be {words}, one for all or one for each of the {ndim} axes")
    return np.array(np.broadcast_to(given, (ndim,)))
