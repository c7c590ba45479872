"""How loops are compiled that others call."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from numba import njit

FAST = {"contract", "reassoc", "nsz", "arcp"}
"""Liberties with the order of sums, so that they fill the vector registers; infinities and NaN keep their meaning."""

ZERO = cast(int, np.int64(0))
"""A number that is no literal, for which functions would be compiled once more."""

_Loop = TypeVar("_Loop", bound=Callable[..., Any])
_INNER: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


def inner(function: _Loop) -> _Loop:
    """Compile a loop that only compiled ones call: sooner, since it has no way in from Python and is not kept alone."""
    return cast(_Loop, njit(**_INNER)(function))


def inlined(function: _Loop) -> _Loop:
    """The same for one that takes hardly longer than its call: it becomes part of its callers.

    Counting the references to its arrays alone doubles the time of a call.
    """
    return cast(_Loop, njit(**_INNER, forceinline=True)(function))


def inner_fast(function: _Loop) -> _Loop:
    """The same for one whose sums may be taken in any order."""
    return cast(_Loop, njit(**_INNER, fastmath=FAST)(function))
