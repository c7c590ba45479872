"""Which resistors matter: how every one of them moves a voltage, and which can change the robot's next step.

The derivatives come from the adjoint network (`resgrid.chip.adjoint`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.chip.adjoint import adjoint_of
from resgrid.chip.figures import Figure, Result, defined
from resgrid.chip.precision import Steps, steps_of
from resgrid.die import end_names
from resgrid.errors import InputError
from resgrid.nodal.operating_point import OperatingPoint
from resgrid.space import Cell, ConfigurationSpace

_WORST = 10


@dataclass(frozen=True, eq=False, repr=False)
class Sensitivity(Result):
    """How firmly a robot's steps are decided.

    In a cell the robot compares the nodes of its face neighbours (free or goal cells) and of the cell itself, and steps
    to the lowest.  The margin is how much lower that is than the runner-up.

    Attributes
    ----------
    op : OperatingPoint
    cells : ndarray of int64, shape (k, axes)
        Where the decisions are made.
    best, runner_up : ndarray of int64, shape (k,)
        Flat index (C order) of the cell stepped to and of the next lowest; the latter may be the cell itself.
    margin : ndarray of float64, shape (k,)
        Voltage of the runner-up above the best, in volts, along the way down.
    flip_drift : ndarray of float64, shape (resistors,)
        Smallest relative change of each resistance that alone changes one of the decisions, to first order; infinite
        where none does, and where the derivative is too small to be told from 0 (`voltage_sensitivity`).  Nonlinear
        resistors follow the others; for them it is the change of ``1 / I0``.
    decision : ndarray of int64, shape (resistors,)
        Which of the ``k`` decisions that is.
    """

    op: OperatingPoint
    cells: NDArray[np.int64]
    best: NDArray[np.int64]
    runner_up: NDArray[np.int64]
    margin: NDArray[np.float64]
    flip_drift: NDArray[np.float64]
    decision: NDArray[np.int64]

    def flips(self, drift: float = 0.01) -> NDArray[np.int64]:
        """Numbers of the resistors whose relative drift by so much changes a decision, weakest first."""
        order = np.argsort(self.flip_drift, kind="stable")
        return order[self.flip_drift[order] <= drift]

    @property
    def figures(self) -> Mapping[str, Figure]:
        """The figures of merit by name, with units and definitions."""
        least = float(self.flip_drift.min(initial=np.inf))
        return {
            "smallest_margin": Figure(
                float(self.margin.min()),
                "V",
                "least distance between the lowest and the next lowest reading on the way",
            ),
            "smallest_flip_drift": Figure(
                defined(least),
                "",
                "smallest relative change of a single resistance that changes a step, to first order",
            ),
            "resistors_flipping_at_1_percent": Figure(
                len(self.flips(0.01)), "", "resistors of which each alone changes a step when it drifts by 1 %"
            ),
        }

    def to_json(self) -> dict[str, Any]:
        """The readings and the resistors that matter most, as plain values."""
        worst = self.flips(np.finfo(np.float64).max)[:_WORST]
        names, cells = end_names(self.op.netlist, worst), self.cells[self.decision[worst]].tolist()
        weakest = [
            {"nodes": pair, "drift": drift, "cell": cell}
            for pair, drift, cell in zip(names, self.flip_drift[worst].tolist(), cells, strict=True)
        ]
        return {**super().to_json(), "weakest": weakest}


def voltage_sensitivity(op: OperatingPoint, weights: ArrayLike) -> NDArray[np.float64]:
    """Derivatives of ``c . V`` with respect to the logarithm of every resistance, in volts, shape (resistors,).

    `weights` (nodes,): ``c``, a single 1 for one node's voltage, 1 and -1 for a difference.  None is off by more than
    1e-5 of the largest, to which the errors of the operating point's currents are added; those that cannot be told from
    0 are 0.  Nonlinear resistors follow the others; for them it is the derivative with respect to ``-ln I0``.
    """
    netlist = op.netlist
    try:
        c = np.asarray(weights, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError("weights must be one number per node") from error
    if c.shape != (netlist.node_count,) or not np.isfinite(c).all():
        raise InputError(f"weights of shape {c.shape} must be {netlist.node_count} finite numbers, one per node")
    if c[op.floating].any():
        node = netlist.node_name(int(op.floating[np.argmax(c[op.floating] != 0)]))
        raise InputError(f"node {node} floats: it has no voltage to be sensitive")
    sign, log_size = adjoint_of(op).derivatives(c)
    return np.asarray(sign * np.exp(log_size))


def analyse_sensitivity(op: OperatingPoint, cells: ArrayLike) -> Sensitivity:
    """Find the resistors that can change a robot's steps: `Study.sensitivity`."""
    steps = steps_of(op)
    where, flat = _checked_cells(steps.cells.space, cells)
    adjoint = adjoint_of(op)
    count = len(adjoint.ends)
    flip, decision = np.full(count, np.inf), np.zeros(count, dtype=np.int64)
    best, runner_up, margin = np.empty_like(flat), np.empty_like(flat), np.empty(len(flat))
    node = steps.cells.node.ravel()
    for number, cell in enumerate(flat.tolist()):
        best[number], runner_up[number], gap, scale = _decision(steps, cell)
        margin[number] = gap * np.exp(scale)
        c = np.zeros(op.netlist.node_count)
        c[node[runner_up[number]]] += 1.0
        c[node[best[number]]] -= 1.0
        slope = adjoint.derivatives(c)[1]
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            drift = np.where(np.isneginf(slope), np.inf, np.exp(np.log(gap) + scale - slope))
        better = drift < flip
        flip[better], decision[better] = drift[better], number
    return Sensitivity(op, where, best, runner_up, margin, flip, decision)


def _decision(steps: Steps, cell: int) -> tuple[int, int, float, float]:
    """The lowest neighbour, the runner-up (or the cell itself), and the distance between them: ``gap exp(scale)`` V."""
    first, last = np.searchsorted(steps.cell, [cell, cell + 1])
    code = steps.cells.space.cell.ravel()
    ways = np.flatnonzero(code[steps.neighbour[first:last]] != Cell.OBSTACLE) + first
    if not np.any(steps.sign[ways] > 0):
        place = tuple(int(i) for i in np.unravel_index(cell, steps.cells.space.shape))
        raise InputError(
            f"cell {place} has no lower neighbour: no current leaves it, so that there is no step to change"
        )
    scale = float(steps.log_volts[ways].max())
    down = steps.sign[ways] * np.exp(steps.log_volts[ways] - scale)
    order = np.argsort(-down, kind="stable")
    best = int(steps.neighbour[ways[order[0]]])
    others = [(float(down[k]), int(steps.neighbour[ways[k]])) for k in order[1:].tolist() if down[k] > 0.0]
    second, runner_up = next(((volts, place) for volts, place in others if place != best), (0.0, cell))
    return best, runner_up, float(down[order[0]]) - second, scale


def _checked_cells(space: ConfigurationSpace, cells: ArrayLike) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    where = np.asarray(cells)
    if where.dtype.kind not in "iu" or where.ndim not in {1, 2} or where.shape[-1] != space.ndim:
        raise InputError(f"cells must be cell indices, {space.ndim} integers each")
    where = where.reshape(-1, space.ndim).astype(np.int64)
    if np.any((where < 0) | (where >= space.shape)):
        raise InputError(f"a cell lies outside the grid of {space.shape} cells")
    code = space.cell[tuple(where.T)]
    where = where[code != Cell.GOAL]
    if np.any(code == Cell.OBSTACLE) or not len(where):
        raise InputError("every cell must be free (a path may end in a goal cell)")
    return where, np.ravel_multi_index(tuple(where.T), space.shape).astype(np.int64)
