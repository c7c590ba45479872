"""How many converter bits a robot needs to see its next step: the precision problem of resistive grids as a number.

Tarassenko & Blake (1991) note that the potential of a grid with obstacles held at a rail is nearly flat far from the
goal.  A converter of ``b`` bits tells two voltages apart when they differ by one step, its range over ``2**b``; a cell
therefore needs ``log2(range / (V - V_best))`` bits, ``V_best`` being the voltage of its lowest face neighbour.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.arguments import check_optional
from resgrid.chip.decisions import steps_of
from resgrid.chip.reading import Reading, json_form
from resgrid.errors import InputError
from resgrid.nodal.operating_point import OperatingPoint
from resgrid.space import Cell, ConfigurationSpace


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

    def __post_init__(self) -> None:
        for array in (self.cell_bits, self.start_bits, self.following):
            array.flags.writeable = False

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
