"""What numbers may be given: one check and one message each."""

from __future__ import annotations

import math
from numbers import Integral, Real
from typing import Any

from resgrid.errors import InputError


def is_number(value: Any) -> bool:
    """Whether a value is a finite real number (True and False are none)."""
    try:
        return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:  # a whole number beyond all floating-point ones
        return False


def is_whole(value: Any) -> bool:
    """Whether a value is a whole number (True and False are none)."""
    return isinstance(value, Integral) and not isinstance(value, bool)


def check_number(
    name: str, value: Any, words: str, *, least: float = -math.inf, above: float = -math.inf, below: float = math.inf
) -> None:
    """Refuse what is no finite real number within limits."""
    if not (is_number(value) and value >= least and above < value < below):
        raise InputError(f"{name} = {value!r} must be {words}")


def check_optional(name: str, value: Any, words: str, *, least: float = -math.inf, above: float = -math.inf) -> None:
    """As `check_number`, for a value that may be None."""
    if value is not None:
        check_number(name, value, words, least=least, above=above)


def check_whole(name: str, value: Any, least: int) -> None:
    """Refuse what is no whole number of at least ``least``."""
    if not (is_whole(value) and int(value) >= least):
        raise InputError(f"{name} = {value!r} must be a whole number, at least {least}")
