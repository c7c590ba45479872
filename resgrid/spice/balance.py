"""Where the power of a circuit comes from and where it goes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.frozen import frozen
from resgrid.nodal.operating_point import OperatingPoint


@frozen
@dataclass(frozen=True, eq=False)
class PowerBalance:
    """Tellegen's theorem, element by element.

    Attributes
    ----------
    source_power : ndarray of float64, shape (sources,)
        Power that every voltage source delivers, in watts; NaN in a loop of sources of more than 0 V.
    current_source_power : ndarray of float64, shape (current sources,)
        Power that every current source delivers, in watts; NaN where it feeds a floating part.
    resistor_power : ndarray of float64, shape (resistors,)
        Power that every resistor dissipates, in watts.
    """

    source_power: NDArray[np.float64]
    current_source_power: NDArray[np.float64]
    resistor_power: NDArray[np.float64]

    @property
    def delivered(self) -> float:
        """Net power of all sources, in watts; NaN if one is undetermined."""
        return float(self.source_power.sum() + self.current_source_power.sum())

    @property
    def dissipated(self) -> float:
        """Power of all resistors, in watts."""
        return float(self.resistor_power.sum())

    @property
    def imbalance(self) -> float:
        """What is left over, relative to all power that flows; NaN if it is undetermined."""
        flowing = np.abs(self.source_power).sum() + np.abs(self.current_source_power).sum() + self.dissipated
        return float(abs(self.delivered - self.dissipated) / flowing) if flowing else 0.0


def power_balance(point: OperatingPoint) -> PowerBalance:
    """Weigh the power that sources deliver against what resistors dissipate.

    Parameters
    ----------
    point : OperatingPoint
        Of resistors and sources; nonlinear resistors are not weighed.

    Returns
    -------
    PowerBalance
    """
    netlist = point.netlist
    volts = netlist.source_volts
    by_voltage = np.where(volts == 0, 0.0, -volts * point.source_current)
    taken, fed = netlist.current_nodes.T
    by_current = netlist.current_amps * (point.voltage[fed] - point.voltage[taken])
    by_current[netlist.current_amps == 0] = 0.0
    with np.errstate(under="ignore"):
        dissipated = point.resistor_current**2 / netlist.conductance
    return PowerBalance(by_voltage, by_current, dissipated)
