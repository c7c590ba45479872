"""Energy over time: what the sources deliver is linear in the state, so that no power needs to be integrated.

By Tellegen's theorem the sources deliver what resistors and capacitors take up.  With node voltages
``V = w + P x`` (``w`` what sources fix, ``P`` from rows to nodes) and Kirchhoff's law at every row that is
``w^T G_n V + w^T C_n V' + x^T P^T I``, ``G_n`` and ``C_n`` being the matrices of all nodes and ``I`` the currents fed
in: its integral needs only the integral of ``x`` and how far ``x`` has moved.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.nodal.dynamics import Dynamics


@dataclass(frozen=True, eq=False)
class EnergyMeter:
    """Coefficients of the energy delivered by all sources.

    Attributes
    ----------
    dynamics : Dynamics
    power : float
        Of the rails alone, in watts, if every other node stood at its fixed part.
    per_integral : ndarray of float64, shape (n,)
        Joules per volt second of every row.
    per_change : ndarray of float64, shape (n,)
        Joules per volt by which every row moves.
    """

    dynamics: Dynamics
    power: float
    per_integral: NDArray[np.float64]
    per_change: NDArray[np.float64]

    def delivered(self, time: float, change: NDArray[np.float64], integral: NDArray[np.float64]) -> float:
        """Energy that sources have delivered since 0+, in joules.

        Parameters
        ----------
        time : float
            In seconds since 0+.
        change : ndarray of float64, shape (n,)
            How far the state has moved, in volts.
        integral : ndarray of float64, shape (n,)
            Integral of the state, in volt seconds.
        """
        return float(self.power * time + self.per_integral @ integral + self.per_change @ change)

    def stored(self, voltage: NDArray[np.float64]) -> float:
        """Energy in the capacitors at node voltages, in joules."""
        netlist = self.dynamics.netlist
        across = np.subtract(*voltage[netlist.capacitor_nodes.T])
        return float(0.5 * np.sum(netlist.capacitance * np.nan_to_num(across) ** 2))


def energy_meter(dynamics: Dynamics) -> EnergyMeter:
    """Prepare the bookkeeping of energy.

    Parameters
    ----------
    dynamics : Dynamics

    Returns
    -------
    EnergyMeter
    """
    netlist = dynamics.netlist
    fixed = np.nan_to_num(dynamics.fixed)
    a, b = netlist.resistor_nodes.T
    through = netlist.conductance * (fixed[a] - fixed[b])
    first, second = netlist.capacitor_nodes.T
    charge = netlist.capacitance * (fixed[first] - fixed[second])
    taken, fed = netlist.current_nodes.T
    amps = netlist.current_amps
    return EnergyMeter(
        dynamics=dynamics,
        power=float(np.sum(through * (fixed[a] - fixed[b]))),
        per_integral=(
            dynamics.injection(a, through)
            - dynamics.injection(b, through)
            + dynamics.injection(fed, amps)
            - dynamics.injection(taken, amps)
        ),
        per_change=dynamics.injection(first, charge) - dynamics.injection(second, charge),
    )
