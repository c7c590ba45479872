"""Resistances that can be bought: rounding to the E96 series, and the usual text of a value."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.chip.effects.values import preferred_values
from resgrid.scene.quantities import prefix_of


def nearest_e96(resistance: ArrayLike) -> NDArray[np.float64]:
    """Return the nearest resistances of the E96 series of IEC 60063, in ohms, in the shape of the argument.

    "Nearest" means the ratio closest to 1. `resistance` (any shape): positive resistances, in ohms.
    """
    ohms = np.asarray(resistance, dtype=np.float64)
    values = np.append(preferred_values("E96"), 10.0)
    exponent = np.floor(np.log10(ohms))
    mantissa = values[np.searchsorted(np.sqrt(values[:-1] * values[1:]), ohms / 10.0**exponent)]
    # Three decimal digits: 9.76 kohm is 9760.0 and not the nearest product of two floats.
    return np.array(
        [float(f"{m:.2f}e{int(e)}") for m, e in zip(mantissa.ravel(), exponent.ravel(), strict=True)]
    ).reshape(ohms.shape)


def resistance_text(ohms: float) -> str:
    """Return a resistance in ohms as text with up to four digits and an SI prefix: ``9.76k``, ``10k``, ``1M``, ``47``.

    This is the form of values on a schematic.
    """
    exponent, prefix = prefix_of(ohms)
    return f"{ohms / 10.0**exponent:.4g}{prefix}"
