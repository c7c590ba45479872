"""Read an operating point off a normwise solution: plain differences of plain numbers, in one pass."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from resgrid.nodal.operating_point import OperatingPoint
from resgrid.nodal.readout import Balance, injected_currents, relative_residual
from resgrid.nodal.sources import source_currents
from resgrid.nodal.system import NodalSystem


def read_plain(
    system: NodalSystem, x: NDArray[np.float64], method: str, seconds: Mapping[str, float]
) -> OperatingPoint:
    """Spread a solution over the nodes, and difference it across the resistors.

    Parameters
    ----------
    system : NodalSystem
    x : ndarray of float64, shape (n,)
        Voltages of the rows above the system's reference, in volts.
    method : str
    seconds : mapping of str to float

    Returns
    -------
    OperatingPoint
        Without ``log_drop``, for which the accuracy would not suffice.
    """
    from resgrid.nodal.assembly import plain_currents

    netlist = system.netlist
    solved = system.unknown >= 0
    height = system.known - system.reference
    height[solved] = x[system.unknown[solved]] + system.forest.offset[solved]
    injected = injected_currents(netlist)
    outflow, through = -injected, np.abs(injected)
    amps = np.empty(len(netlist.conductance))
    power = plain_currents(netlist.resistor_nodes, netlist.conductance, height, amps, outflow, through)
    sums = Balance(np.zeros(len(height)), 0.5 * through, -outflow)
    with np.errstate(divide="ignore"):
        log_amps = np.log(np.abs(amps))
    return OperatingPoint(
        netlist=netlist,
        voltage=system.reference + height,
        log_drop=None,
        potential=_potential(system, height, x),
        resistor_current=amps,
        resistor_log_current=log_amps,
        resistor_direction=np.sign(amps).astype(np.int8),
        source_current=source_currents(netlist, system.forest, outflow),
        power=power,
        kcl_residual=float(np.max(relative_residual(system, sums), initial=0.0)),
        floating=system.floating,
        undriven=system.undriven,
        method=method,
        seconds=seconds,
    )


def _potential(system: NodalSystem, height: NDArray[np.float64], x: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Between two rails the share of their difference; above a single one the share of the highest node."""
    if system.rails is not None:
        return (system.reference + height - system.rails.low) / (system.rails.high - system.rails.low)
    if system.feed.any() or not x.size:
        return None
    if np.all(system.injected >= 0):
        top = float(x.max())
    elif np.all(system.injected <= 0):
        top = float(x.min())
    else:
        return None
    return height / top if top else None
