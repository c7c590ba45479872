"""Scaling the drive of a linear circuit so that its highest node sits at the supply."""

from __future__ import annotations

import numpy as np

from resgrid.circuit.operating_point import OperatingPoint
from resgrid.errors import InputError
from resgrid.netlist import Netlist


def scale_drive(netlist: Netlist, point: OperatingPoint) -> Netlist:
    """Scale the uniform drive so that the highest node sits at the supply.

    The circuit is linear: its voltages above the goal rail scale with the currents fed in.

    Parameters
    ----------
    netlist : Netlist
        Compiled with ``drive="uniform"``.
    point : OperatingPoint
        Its operating point.

    Returns
    -------
    Netlist
        The same circuit with other ``current_amps``.

    Raises
    ------
    InputError
        If the netlist has no uniform drive, has nonlinear resistors, or the operating point is of another netlist.
    """
    cell_map = netlist.cell_map
    if cell_map is None or cell_map.wiring.drive != "uniform":
        raise InputError("only a netlist compiled with drive = 'uniform' has a drive to scale")
    if netlist.nonlinear_nodes.size:
        raise InputError("the voltages of a circuit with nonlinear resistors do not scale with its drive")
    if not point.is_of(netlist):
        raise InputError("the operating point belongs to another netlist; solve this one first")
    height = (point.voltage - cell_map.wiring.goal_voltage) * np.sign(cell_map.wiring.supply)
    factor = abs(cell_map.wiring.supply) / float(np.nanmax(height[cell_map.free_node]))
    return netlist.replace(current_amps=netlist.current_amps * factor)
