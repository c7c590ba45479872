"""Voltages as text."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.nodal.operating_point import OperatingPoint

_PREFIXES = {-12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}


def voltage_texts(op: OperatingPoint | None, nodes: NDArray[np.integer[Any]]) -> tuple[list[str], str]:
    """Voltages of nodes, to a ten-thousandth of the largest voltage in the circuit, and their unit."""
    if op is None:
        return [""] * len(nodes), "V"
    largest = float(np.nanmax(np.abs(op.voltage), initial=0.0))
    if largest == 0:
        return ["0"] * len(nodes), "V"
    power = 0 if 0.5 < largest < 1 else min(max(3 * int(np.floor(np.log10(largest) / 3 + 1e-9)), -12), 9)
    digits = 4 - max(int(np.floor(np.log10(largest) + 1e-9)) - power, 0)
    texts = [f"{value / 10.0**power:.{max(digits, 0)}f}" for value in op.voltage[nodes].tolist()]
    return texts, _PREFIXES[power] + "V"
