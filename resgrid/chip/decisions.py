"""The robot's next step: the neighbour whose node is lowest, cell by cell, right to the last digits.

A voltage step along a resistor is its current over its conductance, which the operating point holds in logarithms: the
steps compare correctly even where voltages themselves have become equal in double precision.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.netlist import CellMap
from resgrid.nodal.operating_point import OperatingPoint
from resgrid.space import Cell

_SMALL = 1e-4
_SATURATED = 1.0 - 1e-16
"""Shares of ``I0`` below which a nonlinear resistor is linear, and above which its voltage cannot be told."""


@dataclass(frozen=True, eq=False)
class Steps:
    """Voltage steps from cells to their face neighbours, one entry per cell and face that a resistor crosses.

    `cell` (s,): flat index (C order) of the free cell left; ascending; `neighbour` (s,): of the cell entered; `sign`
    (s,): 1 where the neighbour is lower (nearer to the goal rail), -1 where it is higher, 0 where both are equal;
    `log_volts` (s,): natural logarithm of the step's size, in volts.
    """

    cell_map: CellMap
    cell: NDArray[np.int64]
    neighbour: NDArray[np.int64]
    sign: NDArray[np.int8]
    log_volts: NDArray[np.float64]

    def lowest(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Lowest neighbour of every cell, -1 where none is lower, and the logarithm of the step down to it (-inf).

        Of equal ones the first, along the axes in their order.

        Returns `neighbour` (cells,), `log_volts` (cells,).
        """
        size = self.cell_map.space.cell.size
        down = np.where(self.sign > 0, self.log_volts, -np.inf)
        best = np.full(size, -np.inf)
        np.maximum.at(best, self.cell, down)
        neighbour = np.full(size, -1, dtype=np.int64)
        winners = np.flatnonzero((self.sign > 0) & (down == best[self.cell]))[::-1]
        neighbour[self.cell[winners]] = self.neighbour[winners]
        return neighbour, best


def steps_of(point: OperatingPoint) -> Steps:
    """Read the voltage steps between neighbouring cells off an operating point.

    Neighbours that no element joins (a broken resistor) are compared by the voltages of their nodes.
    """
    cell_map = point.netlist.cell_map
    if cell_map is None:
        raise InputError("this netlist was not compiled from a space, so there are no cells to step between")
    around = _cells_of_faces(cell_map)
    face, upward, flow, size = _measured(point, cell_map)
    free = _open_faces(cell_map, around)
    free[face] = False
    bare = np.flatnonzero(free)
    bare_flow, bare_size = _compared(point, cell_map.node.ravel()[around[bare]])
    along = np.where(upward, 1, -1).astype(np.int8) * flow
    cell = around[np.append(face, bare)]
    sign = np.append(along, bare_flow) * np.int8(np.sign(cell_map.wiring.supply))
    return _both_ways(cell_map, cell, sign, np.append(size, bare_size))


def _measured(
    point: OperatingPoint, cell_map: CellMap
) -> tuple[NDArray[np.int64], NDArray[np.bool_], NDArray[np.int8], NDArray[np.float64]]:
    """Face, orientation, direction of the current and log of the voltage of every element that crosses a face."""
    netlist = point.netlist
    linear, bent = cell_map.resistor_face >= 0, cell_map.nonlinear_face >= 0
    size = point.resistor_log_current[linear] - np.log(netlist.conductance[linear])
    share = np.abs(point.nonlinear_amps[bent]) / netlist.nonlinear_current[bent]
    with np.errstate(divide="ignore"):
        across = np.log(netlist.nonlinear_voltage[bent]) + np.where(
            share > _SMALL, np.log(np.arctanh(np.minimum(share, _SATURATED))),
            point.nonlinear_log_amps[bent] - np.log(netlist.nonlinear_current[bent]),
        )  # fmt: skip
    return (
        np.append(cell_map.resistor_face[linear], cell_map.nonlinear_face[bent]),
        np.append(cell_map.resistor_upward[linear], cell_map.nonlinear_upward[bent]),
        np.append(point.resistor_direction[linear], point.nonlinear_direction[bent]),
        np.append(size, across),
    )


def _compared(point: OperatingPoint, nodes: NDArray[np.int32]) -> tuple[NDArray[np.int8], NDArray[np.float64]]:
    """Direction from high voltage to low, and log of the difference, between pairs of nodes that nothing joins."""
    first, second = point.voltage[nodes.T]
    down = np.nan_to_num(first - second)
    with np.errstate(divide="ignore"):
        size = np.log(np.abs(down))
    return np.sign(down).astype(np.int8), size


def _both_ways(cell_map: CellMap, cell: NDArray[np.int64], flow: NDArray[np.int8], size: NDArray[np.float64]) -> Steps:
    here = np.concatenate([cell[:, 0], cell[:, 1]])
    there = np.concatenate([cell[:, 1], cell[:, 0]])
    sign = np.concatenate([flow, -flow])
    code = cell_map.space.cell.ravel()
    keep = np.flatnonzero((here >= 0) & (there >= 0))
    keep = keep[code[here[keep]] == Cell.FREE]
    keep = keep[np.lexsort((there[keep], here[keep]))]
    return Steps(cell_map, here[keep], there[keep], sign[keep], np.concatenate([size, size])[keep])


def _cells_of_faces(cell_map: CellMap) -> NDArray[np.int64]:
    """Flat index of the cells below and above every face, -1 beyond the edge; shape (faces, 2)."""
    shape = cell_map.space.shape
    flat = np.arange(cell_map.space.cell.size).reshape(shape)
    parts = []
    for axis in range(len(shape)):
        lines = np.moveaxis(flat, axis, 0)
        beyond = lines[[-1, 0]] if cell_map.space.axes[axis].periodic else np.full((2, *lines.shape[1:]), -1)
        below = np.moveaxis(np.concatenate([beyond[:1], lines]), 0, axis)
        above = np.moveaxis(np.concatenate([lines, beyond[1:]]), 0, axis)
        parts.append(np.stack([below.ravel(), above.ravel()], axis=1))
    return np.concatenate(parts)


def _open_faces(cell_map: CellMap, around: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Faces between two different cells that a robot may occupy and that have nodes, shape (faces,)."""
    may = (cell_map.space.cell.ravel() != Cell.OBSTACLE) & (cell_map.node.ravel() >= 0)
    inside = (around >= 0).all(axis=1) & (around[:, 0] != around[:, 1])
    return np.asarray(inside & may[around].all(axis=1))
