"""Piecewise linear waveforms that multiply the values of all voltage and current sources of a circuit."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.numbers import real_numbers
from resgrid.errors import InputError


class Drive(NamedTuple):
    """Waveform ``w(t)`` of all sources at a time: its value, and its slope in 1/s until the end of a step."""

    value: float
    slope: float


def waveform_corners(waveform: ArrayLike | None) -> NDArray[np.float64]:
    """Return the corners (n, 2) of a waveform: times in seconds and factors; None gives the constant 1.

    Raise InputError unless the times are at least 0 and strictly ascending.
    """
    if waveform is None:
        return np.array([[0.0, 1.0]])
    corners = np.array(real_numbers("waveform", waveform), dtype=np.float64)
    if corners.ndim != 2 or corners.shape[1] != 2 or not len(corners):
        raise InputError(f"waveform has shape {corners.shape}; give one or more pairs of a time and a factor")
    if not np.isfinite(corners).all():
        raise InputError("waveform must hold finite times and factors")
    if corners[0, 0] < 0 or not (np.diff(corners[:, 0]) > 0).all():
        raise InputError("the times of waveform must be at least 0 and strictly ascending, in seconds")
    return corners


def drive_at(corners: NDArray[np.float64], now: float, until: float | None = None) -> Drive:
    """Return the waveform at a time, with its slope until a later time, or the slope 0 without one.

    `corners` (n, 2): corners of the waveform; `now`, `until`: times in seconds, without a corner between them.
    """
    value = float(np.interp(now, *corners.T))
    if until is None or len(corners) == 1:
        return Drive(value, 0.0)
    return Drive(value, (float(np.interp(until, *corners.T)) - value) / (until - now))


def next_corner(corners: NDArray[np.float64], now: float) -> float:
    """Return the time of the first corner after a time, in seconds, infinite without one; `corners` (n, 2)."""
    later = corners[:, 0] > now * (1 + 1e-14)
    return float(corners[later, 0].min(initial=np.inf))
