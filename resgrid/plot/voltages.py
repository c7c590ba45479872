"""Voltages as text."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.nodal.operating_point import OperatingPoint


def voltage_texts(op: OperatingPoint | None, nodes: NDArray[np.int64]) -> tuple[list[str], str]:
    """Voltages of nodes, to a ten-thousandth of the largest voltage in the circuit, and their unit."""
    if op is None:
        return [""] * len(nodes), "V"
    largest = float(np.nanmax(np.abs(op.voltage), initial=0.0))
    power = min(max(3 * int(np.floor(np.log10(largest) / 3 + 1e-9)), -12), 9) if largest > 0 else 0
    if power == -3 and largest > 0.5:
        power = 0
    prefix = {-12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}[power]
    digits = 4 - int(np.floor(np.log10(largest / 10.0**power) + 1e-9)) if largest > 0 else 4
    return [f"{value / 10.0**power:.{max(digits, 0)}f}" for value in op.voltage[nodes].tolist()], prefix + "V"
