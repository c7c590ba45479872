"""The robot's next step: the neighbour whose node is lowest, cell by cell, right to the last digits.

A voltage step along a resistor is its current over its conductance, which the operating point holds in logarithms: the
steps compare correctly even where voltages themselves have become equal in double precision.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.arguments import check_optional
from resgrid.chip.figures import Reading, json_form
from resgrid.errors import InputError
from resgrid.frozen import frozen, picture_html
from resgrid.netlist import CellMap
from resgrid.nodal.operating_point import OperatingPoint
from resgrid.space import Cell, ConfigurationSpace

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


@frozen
@dataclass(frozen=True, eq=False)
class Precision:
    """Converter bits that the cells of a space need.

    Attributes
    ----------
    space : ConfigurationSpace
    span : float
        Range of the converter, in volts.
    cell_bits : ndarray of float64, shape of the space
        Bits at which one step of the converter is as large as the step down to the best neighbour; infinite where no
        neighbour is lower, NaN in cells that are not free or have no way to a goal.
    start_bits : ndarray of float64, shape of the space
        The most that any cell on the way from there to the goal needs, each step leading to the lowest neighbour.
    following : ndarray of int64, shape of the space
        Flat index (C order) of the lowest neighbour, -1 for none.
    boundary : str
        ``"dirichlet"``, ``"neumann"`` or ``"wall"``.
    """

    space: ConfigurationSpace
    span: float
    cell_bits: NDArray[np.float64]
    start_bits: NDArray[np.float64]
    following: NDArray[np.int64]
    boundary: str

    _repr_html_ = picture_html

    @property
    def starts(self) -> NDArray[np.float64]:
        """Bits that every start with a way to a goal needs, in C order of the cells."""
        return self.start_bits[self.space.goal_connected]

    def served(self, bits: float) -> float:
        """Share of the starts that a read-out of so many bits serves, among those with a way to a goal; NaN of none."""
        return float(np.mean(self.starts <= bits)) if self.starts.size else float("nan")

    def bits_for(self, share: float) -> int | None:
        """Fewest whole bits that serve a share of the starts; None if no number of bits does."""
        if not 0 <= share <= 1:
            raise InputError(f"share = {share} must lie between 0 and 1")
        ordered = np.sort(self.starts)
        if not ordered.size:
            return None
        needed = ordered[max(int(np.ceil(share * len(ordered) - 1e-9)) - 1, 0)]
        return max(int(np.ceil(needed)), 1) if np.isfinite(needed) else None

    def sentence(self, bits: int = 10) -> str:
        """What a read-out of so many bits is worth, e.g. ``"a 10-bit read-out serves 63 % of the starts"``."""
        if not self.starts.size:
            return "no start has a way to a goal"
        article = "an" if str(bits).startswith("8") or bits in {11, 18} else "a"
        share = 100 * self.served(bits)
        # Rounded down, so that 100 % means all of them.
        return f"{article} {bits}-bit read-out serves {np.floor(share + 1e-9):.0f} % of the starts"

    @property
    def readings(self) -> Mapping[str, Reading]:
        """The figures, with units and definitions."""
        most = float(self.starts.max(initial=-np.inf))
        typical = float(np.median(self.starts)) if self.starts.size else np.nan
        of = f"of a converter of range {self.span:g} V"
        result = {
            "most_bits": Reading(
                most if np.isfinite(most) else None,
                "bit",
                f"bits {of} that the most demanding start needs: log2(range over the smallest step down on its way)",
            ),
            "median_bits": Reading(
                typical if np.isfinite(typical) else None, "bit", f"bits {of} that serve half of the starts"
            ),
        }
        for bits in (8, 10, 12, 16):
            result[f"served_{bits}_bits"] = Reading(
                self.served(bits) if self.starts.size else None,
                "",
                f"share of the starts with a path that a {bits}-bit read-out serves",
            )
        return result

    def to_json(self) -> dict[str, Any]:
        """The readings and the sentence, as plain values."""
        return {**json_form(self.readings), "boundary": self.boundary, "sentence": self.sentence()}


def analyse_precision(point: OperatingPoint, *, span: float | None = None) -> Precision:
    """Find out how many bits a read-out needs.

    Parameters
    ----------
    point : OperatingPoint
        Of a netlist with a map of cells.
    span : float, optional
        Range of the converter, in volts; by default the supply or, with a uniform drive, the height of the highest
        node above the goal rail (which `resgrid.scale_drive` makes the supply).

    Returns
    -------
    Precision

    Raises
    ------
    InputError
        If the netlist has no map of cells, or the range is not positive.
    """
    check_optional("span", span, "positive and finite, in volts", above=0.0)
    steps = steps_of(point)
    cell_map = steps.cell_map
    space = cell_map.space
    reach = _span(point) if span is None else float(span)
    following, log_volts = steps.lowest()
    way = space.goal_connected.ravel()
    bits = np.where(way, (np.log(reach) - log_volts) / np.log(2.0), np.nan)
    return Precision(
        space=space,
        span=reach,
        cell_bits=bits.reshape(space.shape),
        start_bits=_along_the_way(bits, following, space).reshape(space.shape),
        following=np.where(way, following, -1).reshape(space.shape),
        boundary=cell_map.wiring.boundary,
    )


def _span(point: OperatingPoint) -> float:
    cell_map = point.netlist.cells
    if cell_map.wiring.drive != "uniform":
        return abs(cell_map.wiring.supply)
    return float(np.nanmax(np.abs(point.voltage[cell_map.free_node] - cell_map.wiring.goal_voltage)))


def _along_the_way(
    bits: NDArray[np.float64], following: NDArray[np.int64], space: ConfigurationSpace
) -> NDArray[np.float64]:
    """Largest value from every cell to the end of its way, by doubling the length looked ahead."""
    goal = space.cell.ravel() == Cell.GOAL
    most = np.where(goal, -np.inf, bits)
    ahead = np.where(following < 0, np.arange(len(bits)), following)
    for _ in range(int(np.ceil(np.log2(len(bits) + 1)))):
        most = np.maximum(most, most[ahead])
        ahead = ahead[ahead]
    return np.where(np.isnan(bits), np.nan, most)
