"""The robot's next step: the neighbour whose node is lowest, cell by cell, right to the last digits.

A voltage step along a resistor is its current over its conductance, which the operating point holds in logarithms: the
steps compare correctly even where voltages themselves have become equal in double precision.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.netlist import Layout
from resgrid.nodal.operating_point import OperatingPoint
from resgrid.space import Cell


@dataclass(frozen=True, eq=False)
class Steps:
    """Voltage steps from cells to their face neighbours, one entry per cell and face that a resistor crosses.

    Attributes
    ----------
    layout : Layout
    cell : ndarray of int64, shape (s,)
        Flat index (C order) of the free cell left; ascending.
    neighbour : ndarray of int64, shape (s,)
        Of the cell entered.
    sign : ndarray of int8, shape (s,)
        1 where the neighbour is lower (nearer to the goal rail), -1 where it is higher, 0 where both are equal.
    log_volts : ndarray of float64, shape (s,)
        Natural logarithm of the step's size, in volts.
    """

    layout: Layout
    cell: NDArray[np.int64]
    neighbour: NDArray[np.int64]
    sign: NDArray[np.int8]
    log_volts: NDArray[np.float64]

    def lowest(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Lowest neighbour of every cell, -1 where none is lower, and the logarithm of the step down to it (-inf).

        Of equal ones the first, along the axes in their order.

        Returns
        -------
        neighbour : ndarray of int64, shape (cells,)
        log_volts : ndarray of float64, shape (cells,)
        """
        size = self.layout.space.cell.size
        down = np.where(self.sign > 0, self.log_volts, -np.inf)
        best = np.full(size, -np.inf)
        np.maximum.at(best, self.cell, down)
        neighbour = np.full(size, -1, dtype=np.int64)
        winners = np.flatnonzero((self.sign > 0) & (down == best[self.cell]))[::-1]
        neighbour[self.cell[winners]] = self.neighbour[winners]
        return neighbour, best


def steps_of(point: OperatingPoint) -> Steps:
    """Read the voltage steps between neighbouring cells off an operating point.

    Parameters
    ----------
    point : OperatingPoint
        Of a netlist with a layout, in which every two neighbours are joined by one element.

    Returns
    -------
    Steps

    Raises
    ------
    InputError
        If the netlist has no layout.
    """
    netlist = point.netlist
    layout = netlist.layout
    if layout is None:
        raise InputError("this netlist was not compiled from a space, so there are no cells to step between")
    between = layout.resistor_face >= 0
    ends = netlist.resistor_nodes[between]
    flow = point.resistor_direction[between]
    size = point.resistor_log_current[between] - np.log(netlist.conductance[between])
    cell = _cell_of_end(layout, ends, layout.resistor_face[between], layout.resistor_upward[between])
    across = np.subtract(*np.nan_to_num(point.voltage)[netlist.nonlinear_nodes.T])
    if len(across):
        with np.errstate(divide="ignore"):
            bent = netlist.nonlinear_voltage * np.arctanh(np.abs(point.nonlinear_amps) / netlist.nonlinear_current)
            size = np.append(size, np.log(bent))
        flow = np.append(flow, point.nonlinear_direction)
        ends = np.concatenate([ends, netlist.nonlinear_nodes])
        extra = _cell_of_end(layout, netlist.nonlinear_nodes, layout.nonlinear_face, layout.nonlinear_upward)
        cell = np.concatenate([cell, extra])
    return _both_ways(layout, cell, np.asarray(flow * int(np.sign(layout.supply))).astype(np.int8), size)


def _both_ways(layout: Layout, cell: NDArray[np.int64], flow: NDArray[np.int8], size: NDArray[np.float64]) -> Steps:
    here = np.concatenate([cell[:, 0], cell[:, 1]])
    there = np.concatenate([cell[:, 1], cell[:, 0]])
    sign = np.concatenate([flow, -flow])
    code = layout.space.cell.ravel()
    keep = np.flatnonzero((here >= 0) & (there >= 0))
    keep = keep[code[here[keep]] == Cell.FREE]
    keep = keep[np.lexsort((there[keep], here[keep]))]
    return Steps(layout, here[keep], there[keep], sign[keep], np.concatenate([size, size])[keep])


def _cell_of_end(
    layout: Layout, ends: NDArray[np.int64], face: NDArray[np.int64], upward: NDArray[np.bool_]
) -> NDArray[np.int64]:
    """Cells below and above every resistor's face in the order of its nodes, shape (m, 2); -1 beyond the edge."""
    shape = layout.space.shape
    result = np.full(ends.shape, -1, dtype=np.int64)
    first = 0
    for axis, size in enumerate(shape):
        grid = (*shape[:axis], size + 1, *shape[axis + 1 :])
        count = int(np.prod(grid))
        mine = np.flatnonzero((face >= first) & (face < first + count))
        index = np.stack(np.unravel_index(face[mine] - first, grid), axis=1)
        for column, offset in ((0, -1), (1, 0)):
            place = index.copy()
            place[:, axis] += offset
            if layout.space.axes[axis].periodic:
                place[:, axis] %= size
            inside = (place[:, axis] >= 0) & (place[:, axis] < size)
            flat = np.ravel_multi_index(tuple(place[inside].T), shape)
            side = np.where(upward[mine[inside]], column, 1 - column)
            result[mine[inside], side] = flat
        first += count
    return result
