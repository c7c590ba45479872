"""Resolution of the analogue-to-digital converter: the bits that a robot needs to find its next step.

Tarassenko & Blake (1991) note that the potential of a grid with obstacles held at a rail is nearly flat far from the
goal.  A converter of ``b`` bits resolves two voltages that differ by one step, its range over ``2**b``.  A cell with
the voltage ``V`` therefore needs ``log2(range / (V - V_best))`` bits, where ``V_best`` is the voltage of its lowest
face neighbour.

The voltage step along a resistor is its current over its conductance.  The operating point contains logarithms of
currents, so that steps compare correctly even where voltages are equal in double precision.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.numbers import Positive, check_fraction
from resgrid.chip.figures_of_merit import Figure, Result, defined
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.core.cell import Cell
from resgrid.core.cell_map import CellMap
from resgrid.core.regions import cells_at_faces, with_margin
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError

_MOST_CELLS = 400
"""Maximum number of cells that `ADCResolution.cells_passed` returns; later cells on the paths are left out."""

_SMALL = 1e-4
"""Ratio of a nonlinear resistor's current to its saturation current, up to which the resistor counts as linear when the
voltage across it is computed.
"""

_SATURATED = 1.0 - 1e-16
"""Largest current of a nonlinear resistor, as a fraction of its saturation current, in the computation of its voltage.
A larger current is replaced by this limit, because its voltage would consist of rounding errors.
"""


@dataclass(frozen=True, eq=False)
class Steps:
    """Voltage steps from free cells to their face neighbours, one entry (of ``s``) for each pair of cell and neighbour.

    `cells`: map of the cells; `cell` (s,): flat index (C order) of the free cell, ascending; `neighbour` (s,): flat
    index of the free or goal cell across the face; `sign` (s,): 1 where the neighbour is lower (nearer to the goal
    rail), -1 where it is higher, 0 where both are equal; `log_volts` (s,): natural logarithm of the magnitude of the
    step in volts, minus infinity for equal voltages.
    """

    cells: CellMap
    cell: NDArray[np.int64]
    neighbour: NDArray[np.int64]
    sign: NDArray[np.int8]
    log_volts: NDArray[np.float64]

    def lowest(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the flat index of the lowest neighbour of every cell, and the natural log of the voltage step to it.

        Both arrays have shape (cells,); the step is in volts.  For a cell without a lower neighbour they contain -1 and
        minus infinity.  Among equal neighbours the one with the first entry is returned.
        """
        size = self.cells.space.cell.size
        down = np.where(self.sign > 0, self.log_volts, -np.inf)
        best = np.full(size, -np.inf)
        np.maximum.at(best, self.cell, down)
        neighbour = np.full(size, -1, dtype=np.int64)
        winners = np.flatnonzero((self.sign > 0) & (down == best[self.cell]))[::-1]
        neighbour[self.cell[winners]] = self.neighbour[winners]
        return neighbour, best


def enterable(space: ConfigurationSpace) -> NDArray[np.bool_]:
    """Return the mask of the cells that a robot can enter (free and goal cells), shape of the space."""
    return np.asarray(space.cell != Cell.OBSTACLE)


def steps_of(op: OperatingPoint) -> Steps:
    """Return the voltage steps from every free cell to its free and goal face neighbours, as Steps.

    The step across a resistor is its current over its conductance.  Without a resistor between two neighbours, the step
    is the difference of their voltages.  `op`: operating point of a netlist with cells.
    """
    cells = op.netlist.cells
    space, node = cells.space, cells.node.ravel()
    code = space.cell.ravel()
    around = _cells_of_faces(space)
    face, upward, flow, log_volts = _across_elements(op, cells)
    unjoined = (around >= 0).all(axis=1) & (around[:, 0] != around[:, 1])
    may_enter = enterable(space).ravel()
    unjoined &= (may_enter & (node >= 0))[around].all(axis=1)
    unjoined[face] = False
    pairs = around[unjoined]
    down = np.nan_to_num(np.subtract(*op.voltage[node[pairs.T]]))
    with np.errstate(divide="ignore"):
        log_volts = np.append(log_volts, np.log(np.abs(down)))
    sign = np.append(np.where(upward, 1, -1) * flow, np.sign(down)).astype(np.int8) * np.int8(
        np.sign(cells.wiring.supply)
    )
    here, there = np.concatenate([around[face], pairs]).T
    here, there = np.append(here, there), np.append(there, here)
    keep = np.flatnonzero((here >= 0) & (there >= 0))
    keep = keep[(code[here[keep]] == Cell.FREE) & may_enter[there[keep]]]
    keep = keep[np.lexsort((there[keep], here[keep]))]
    return Steps(cells, here[keep], there[keep], np.append(sign, -sign)[keep], np.tile(log_volts, 2)[keep])


def _across_elements(
    op: OperatingPoint, cells: CellMap
) -> tuple[NDArray[np.int64], NDArray[np.bool_], NDArray[np.int8], NDArray[np.float64]]:
    """Return face, orientation, direction of the current, and voltage of all resistors that cross a cell face.

    The result has four arrays (elements,), linear resistors first: number of the face; True if the first end of the
    resistor lies in the cell at the lower coordinate; sign of the current, positive from the first end to the second
    (-1, 0 or 1); natural logarithm of the magnitude of the voltage across the resistor in volts.  `op`: operating
    point; `cells`: map of the cells.
    """
    netlist = op.netlist
    linear, nonlinear = cells.resistor_face >= 0, cells.nonlinear_face >= 0
    log_volts = op.resistor_log_current[linear] - np.log(netlist.conductance[linear])
    share = np.abs(op.nonlinear_amps[nonlinear]) / netlist.nonlinear_current[nonlinear]
    small = op.nonlinear_log_amps[nonlinear] - np.log(netlist.nonlinear_current[nonlinear])
    with np.errstate(divide="ignore"):
        large = np.log(np.arctanh(np.minimum(share, _SATURATED)))
        log_saturating = np.log(netlist.nonlinear_voltage[nonlinear]) + np.where(share > _SMALL, large, small)
    return (
        np.append(cells.resistor_face[linear], cells.nonlinear_face[nonlinear]),
        np.append(cells.resistor_upward[linear], cells.nonlinear_upward[nonlinear]),
        np.append(op.resistor_direction[linear], op.nonlinear_direction[nonlinear]),
        np.append(log_volts, log_saturating),
    )


def _cells_of_faces(space: ConfigurationSpace) -> NDArray[np.int64]:
    """Return the flat indices of the cells on both sides of every cell face, shape (faces, 2); -1 outside the grid.

    The cell at the lower coordinate comes first.  Faces are numbered axis by axis, in C order along each axis.
    """
    wide = with_margin(np.arange(space.cell.size).reshape(space.shape), space.periodic, beyond=-1)
    sides = (cells_at_faces(wide, axis) for axis in range(space.ndim))
    return np.concatenate([np.stack([below.ravel(), above.ravel()], axis=1) for below, above in sides])


@dataclass(frozen=True, eq=False, repr=False)
class ADCResolution(Result):
    """Converter bits that the cells of a space need.

    Returned by `resgrid.chip.Study.adc_resolution`.

    Attributes
    ----------
    space : ConfigurationSpace
        The space of the chip.
    span : float
        Range of the converter, in volts.
    cell_bits : ndarray of float64, shape of the space
        Bits at which one step of the converter equals the voltage step to the lowest face neighbour.  Infinite where no
        neighbour is lower; NaN in cells that are not free or have no path to a goal.
    start_bits : ndarray of float64, shape of the space
        Largest `cell_bits` along the path from a cell to the goal, in which each step leads to the lowest face
        neighbour.  Infinite where a cell of the path has no lower neighbour; NaN in cells that are not free or have no
        path to a goal.
    following : ndarray of int64, shape of the space
        Flat index (C order) of the face neighbour with the lowest voltage above the goal rail; -1 if no neighbour is
        lower than the cell, and in cells that are not free or have no path to a goal.
    boundary : str
        Boundary condition of the circuit: ``"dirichlet"``, ``"neumann"`` or ``"wall"``.
    starts : ndarray of float64, shape (k,)
        The `start_bits` of the k free cells with a path to a goal, in C order of the cells.
    figures : mapping of str to Figure
        Figures of merit by name.

    Examples
    --------
    >>> resolution = rg.study(rg.read_scene("examples/scenes/lesson.toml")).adc_resolution()
    >>> resolution.sentence(8), resolution.bits_for(1.0)
    ('an 8-bit read-out serves 60 % of the starts', 12)
    >>> print(resolution.figures["most_bits"])
    11.57 bit
    >>> resolution.cell_bits[6, 2:5].round(2)
    array([0.8 , 2.14, 3.22])
    """

    space: ConfigurationSpace
    span: float
    cell_bits: NDArray[np.float64]
    start_bits: NDArray[np.float64]
    following: NDArray[np.int64]
    boundary: str

    @property
    def starts(self) -> NDArray[np.float64]:
        """Bits of a converter that a robot needs to reach a goal, from every start with a path to a goal, shape (k,).

        The order is the C order of the start cells.
        """
        return self.start_bits[self.space.goal_connected]

    def served(self, bits: float) -> float:
        """Return the fraction of the starts (free cells with a path to a goal) that a read-out serves.

        Parameters
        ----------
        bits : float
            Resolution of the read-out.

        Returns
        -------
        float
            Fraction of the starts whose `start_bits` are at most `bits`; NaN without a start.
        """
        return float(np.mean(self.starts <= bits)) if self.starts.size else float("nan")

    def bits_for(self, fraction: float) -> int | None:
        """Return the smallest number of bits that serves a fraction of the starts.

        Parameters
        ----------
        fraction : float
            The fraction of the starts, in [0, 1].

        Returns
        -------
        int or None
            Number of bits, at least 1; None if no number of bits serves the fraction.

        Raises
        ------
        InputError
            If `fraction` is out of range.
        """
        check_fraction("fraction", fraction)
        ordered = np.sort(self.starts)
        if not ordered.size:
            return None
        needed = ordered[max(int(np.ceil(fraction * len(ordered) - 1e-9)) - 1, 0)]
        return max(int(np.ceil(needed)), 1) if np.isfinite(needed) else None

    def cells_passed(self, starts: Sequence[tuple[int, ...]] = ()) -> NDArray[np.int64]:
        """Return the cells on the paths from some starts, in which each step leads to the lowest face neighbour.

        Parameters
        ----------
        starts : sequence of tuple of int
            Indices of start cells; starts without a path to a goal are left out.  If none is left, the path from the
            start with the largest finite `start_bits` is returned.

        Returns
        -------
        ndarray of int64, shape (k, axes)
            Indices of the first 400 cells at most, without goal cells, in the order in which the paths pass them.

        Raises
        ------
        InputError
            If no start has a lower neighbour.
        """
        shape = self.space.shape
        bits = np.where(np.isfinite(self.start_bits), self.start_bits, -np.inf)
        hardest = tuple(int(index) for index in np.unravel_index(int(bits.argmax()), shape))
        begins = [start for start in starts if self.space.goal_connected[start]] or [hardest]
        following, goal = self.following.ravel(), self.space.cell.ravel() == Cell.GOAL
        passed: dict[int, None] = {}  # an ordered set
        for begin in begins:
            cell = int(np.ravel_multi_index(begin, shape))
            while cell >= 0 and not goal[cell] and cell not in passed and following[cell] >= 0:
                passed[cell] = None
                cell = int(following[cell])
        if not passed:
            raise InputError("no start has a lower neighbour on this chip, so there is no step to examine")
        return np.stack(np.unravel_index(list(passed)[:_MOST_CELLS], shape), axis=1)

    def sentence(self, bits: int = 10) -> str:
        """Return a sentence on a read-out, such as ``"a 10-bit read-out serves 63 % of the starts"``.

        Parameters
        ----------
        bits : int
            Resolution of the read-out.

        Returns
        -------
        str
            The sentence.  The percentage is rounded down, so that 100 % means all starts.
        """
        if not self.starts.size:
            return "no start has a path to a goal"
        article = "an" if str(bits).startswith("8") or bits in {11, 18} else "a"
        share = 100 * self.served(bits)
        return f"{article} {bits}-bit read-out serves {np.floor(share + 1e-9):.0f} % of the starts"

    @property
    def figures(self) -> Mapping[str, Figure]:
        """Figures of merit by name: converter bits that starts need, and fractions of the starts that converters serve.

        ``most_bits`` and ``median_bits``: bits for the most demanding start, and for half of the starts;
        ``served_8_bits`` (also 10, 12, 16): fraction of the starts for which this number of bits is enough.  Values are
        None without starts.
        """
        most = float(self.starts.max(initial=-np.inf))
        typical = float(np.median(self.starts)) if self.starts.size else np.nan
        of = f"of a converter of range {self.span:g} V"
        result = {
            "most_bits": Figure(
                defined(most),
                "bit",
                f"bits {of} that the most demanding start needs: log2(range / smallest step down on its path)",
            ),
            "median_bits": Figure(defined(typical), "bit", f"bits {of} that serve half of the starts"),
        }
        for bits in (8, 10, 12, 16):
            result[f"served_{bits}_bits"] = Figure(
                self.served(bits) if self.starts.size else None,
                "",
                f"fraction of the starts with a path that a {bits}-bit read-out serves",
            )
        return result

    def to_json(self) -> dict[str, Any]:
        """Return the result as a dictionary for JSON.

        Keys: the names of `figures`, each with a dictionary of ``value``, ``unit`` and ``definition``; ``boundary``:
        name of the boundary condition; ``sentence``: summary in words.
        """
        return {**super().to_json(), "boundary": self.boundary, "sentence": self.sentence()}


def analyse_adc_resolution(op: OperatingPoint, *, span: Positive | None = None) -> ADCResolution:
    """Compute the converter bits that every cell and every start needs; return them as an ADCResolution.

    `op`: operating point of the chip; `span`: range of the converter in volts, None for the supply or, with a uniform
    drive, for the largest voltage between a node and the goal rail.
    """
    steps = steps_of(op)
    space, wiring = steps.cells.space, steps.cells.wiring
    if span is not None:
        reach = float(span)
    elif wiring.drive == "uniform":
        reach = float(np.nanmax(np.abs(op.voltage[steps.cells.free_node] - wiring.goal_voltage)))
    else:
        reach = abs(wiring.supply)
    following, log_volts = steps.lowest()
    served = space.goal_connected.ravel()
    bits = np.where(served, (np.log(reach) - log_volts) / np.log(2.0), np.nan)
    return ADCResolution(
        space=space,
        span=reach,
        cell_bits=bits.reshape(space.shape),
        start_bits=_largest_ahead(bits, following, space).reshape(space.shape),
        following=np.where(served, following, -1).reshape(space.shape),
        boundary=wiring.boundary,
    )


def _largest_ahead(
    bits: NDArray[np.float64], following: NDArray[np.int64], space: ConfigurationSpace
) -> NDArray[np.float64]:
    """Return the largest value of `bits` from every cell to the end of its path, shape (cells,), by pointer doubling.

    The result is NaN where `bits` is NaN.  `bits` (cells,): values, NaN except in free cells with a path to a goal;
    `following` (cells,): flat index of the next cell on the path, -1 at an end; `space`: gives the goal cells, whose
    values do not count.
    """
    most = np.where(space.cell.ravel() == Cell.GOAL, -np.inf, bits)
    ahead = np.where(following < 0, np.arange(len(bits)), following)
    for _ in range(int(np.ceil(np.log2(len(bits) + 1)))):
        most = np.maximum(most, most[ahead])
        ahead = ahead[ahead]
    return np.where(np.isnan(bits), np.nan, most)
