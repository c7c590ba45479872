"""How the loops of the multigrid solver are compiled."""

from __future__ import annotations

import numpy as np

FAST = {"contract", "reassoc", "nsz", "arcp"}
"""Liberties with the order of sums, so that they fill the vector registers; infinities and NaN keep their meaning."""

INNER = {"cache": True, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""Options of loops that only other loops call: without a way in from Python they compile in less time."""

ZERO = np.int64(0)
"""A zero that is no literal, for which functions would be compiled once more."""
