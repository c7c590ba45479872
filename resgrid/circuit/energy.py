"""Energy over time, from how far the state has moved and its integral: no power needs to be integrated.

By Tellegen's theorem the sources deliver what resistors and capacitors take up, and so they do when the currents are
weighted by any other voltages ``W`` that the same sources allow: with node voltages ``V = W + P y`` (``P`` from rows to
nodes) the power is ``W^T G_n V + W^T C_n V' + y^T P^T I``, ``G_n`` and ``C_n`` being the matrices of all nodes and
``I`` the currents fed in.  For ``W`` the mean voltages are taken, whose ``y`` has no integral.  What is left is the
power that resistors turn into heat at the mean voltages, and the charge that every capacitor takes up, brought there
against its mean voltage: differences across elements, none of which is counted from ground.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.dynamics import Dynamics


@dataclass(frozen=True, eq=False)
class EnergyMeter:
    """What all sources deliver, and what the capacitors hold."""

    dynamics: Dynamics

    def delivered(self, time: float, change: NDArray[np.float64], integral: NDArray[np.float64]) -> float:
        """Energy that sources have delivered since 0+, in joules; floating parts count nothing.

        Shapes: `change` (n,), `integral` (n,).
        """
        if not time > 0.0:
            return 0.0
        netlist = self.dynamics.netlist
        mean = self.dynamics.voltage(integral / time)
        heat = netlist.conductance * _across(mean, netlist.resistor_nodes) ** 2
        moved = netlist.capacitance * _across(self.dynamics.at_nodes(change), netlist.capacitor_nodes)
        return float(time * heat.sum() + moved @ _across(mean, netlist.capacitor_nodes))

    def stored(self, voltage: NDArray[np.float64]) -> float:
        """Energy in the capacitors at node voltages, in joules."""
        netlist = self.dynamics.netlist
        return float(0.5 * np.sum(netlist.capacitance * _across(voltage, netlist.capacitor_nodes) ** 2))


def _across(voltage: NDArray[np.float64], nodes: NDArray[np.int32]) -> NDArray[np.float64]:
    """Voltage across elements, 0 where it floats."""
    first, second = voltage[nodes.T]
    return np.asarray(np.nan_to_num(first - second))
