"""Sensitivity: derivatives of voltages with respect to resistances, and resistors that can change a step of the robot.

The adjoint network (Director & Rohrer 1969) of a resistor network is the network itself.  With ``G lambda = c``, the
functional ``F = c . V`` changes by ``I_k (lambda_a - lambda_b)`` per relative increase of the resistance ``k`` between
nodes ``a`` and ``b`` with the current ``I_k`` from ``a`` to ``b``.  One linear solve gives all derivatives.

Far from the nonzero entries of ``c``, ``lambda`` decreases by as many orders of magnitude as the currents grow.  An
error that is small relative to the largest ``lambda`` would there cause a large derivative.  Therefore every difference
of ``lambda`` has an error bound.  A residual ``r`` causes an error ``e`` with the energy ``sum g_k (e_a - e_b)^2 = r .
G^-1 r``.  Since ``G^-1`` has no negative entry, the energy is at most ``sum h_i r_i^2`` with ``G h = 1`` (Schur's
test).  Where this bound is too large, the positive and the negative part of ``c`` are solved separately, with
componentwise accuracy.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.chip.adc_resolution import Steps, steps_of
from resgrid.chip.figures_of_merit import Figure, Result, defined
from resgrid.circuit.equations import assemble
from resgrid.circuit.linear import CircuitFactor, factor_circuit
from resgrid.circuit.nonlinear import linearize
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.core.cell import Cell
from resgrid.core.random_sites import end_names, ends_of
from resgrid.core.regions import label_components
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import AccuracyError, InputError
from resgrid.planning.trace import cell_indices
from resgrid.solvers.progress import ProgressMonitor
from resgrid.solvers.scaled import Scaled, logarithm, power

_WORST = 10
"""Number of the most sensitive resistors that `Sensitivity.to_json` lists."""


@dataclass(frozen=True, eq=False, repr=False)
class Sensitivity(Result):
    """Margins of a robot's steps, and the resistors that can change a step.

    Returned by `resgrid.chip.Study.sensitivity`.  In a cell the robot compares the nodes of the face neighbours (free
    or goal cells) and of the cell itself, and steps to the lowest.  The margin is the voltage between the second lowest
    and the lowest.

    Attributes
    ----------
    op : OperatingPoint
        Operating point of the chip.
    cells : ndarray of int64, shape (k, axes)
        Indices of the cells in which the robot decides.
    best, runner_up : ndarray of int64, shape (k,)
        Flat index (C order) of the lowest neighbour, to which the robot steps, and of the second lowest cell, which may
        be the cell of the decision itself.
    margin : ndarray of float64, shape (k,)
        Voltage of the second lowest above the lowest, in volts, counted towards the obstacle rail.
    flip_drift : ndarray of float64, shape (resistors,)
        Smallest relative change of each resistance that changes one of the decisions, to first order.  Infinite where
        no change of the resistance does, and where the derivative is below its error (`voltage_sensitivity`).
        Nonlinear resistors follow the linear ones; their relative change is that of ``1 / I0``, with the saturation
        current ``I0``.
    decision : ndarray of int64, shape (resistors,)
        Index, in `cells`, of the decision that each resistor changes first; 0 where `flip_drift` is infinite.
    figures : mapping of str to Figure
        Figures of merit by name.

    Examples
    --------
    >>> sensitivity = rg.study(rg.read_scene("examples/scenes/lesson.toml")).sensitivity()
    >>> print(sensitivity.figures["smallest_margin"], sensitivity.figures["smallest_flip_drift"])
    45.15 µV 0.007782
    >>> weakest = sensitivity.flips(drift=0.01)
    >>> sensitivity.flip_drift[weakest].round(4), sensitivity.cells[sensitivity.decision[weakest]]
    (array([0.0078, 0.0078]), array([[4, 6],
           [4, 6]]))
    """

    op: OperatingPoint
    cells: NDArray[np.int64]
    best: NDArray[np.int64]
    runner_up: NDArray[np.int64]
    margin: NDArray[np.float64]
    flip_drift: NDArray[np.float64]
    decision: NDArray[np.int64]

    def flips(self, drift: float = 0.01) -> NDArray[np.int64]:
        """Return the numbers of the resistors that can change a decision, most sensitive first.

        Parameters
        ----------
        drift : float
            Largest relative change of a resistance.

        Returns
        -------
        ndarray of int64, shape (m,)
            Numbers of the resistors with ``flip_drift <= drift``, indices into `flip_drift`.
        """
        order = np.argsort(self.flip_drift, kind="stable")
        return order[self.flip_drift[order] <= drift]

    @property
    def figures(self) -> Mapping[str, Figure]:
        """Figures of merit by name, on the lowest and the second lowest reading at each cell of the path.

        ``smallest_margin``: smallest voltage between both, in volts; ``smallest_flip_drift``: smallest relative change
        of one resistance that changes a step, None if none does; ``resistors_flipping_at_1_percent``: number of
        resistors of which a relative change of 1 % alone changes a step.
        """
        least = float(self.flip_drift.min(initial=np.inf))
        return {
            "smallest_margin": Figure(
                float(self.margin.min()),
                "V",
                "smallest voltage between the lowest and the second lowest reading on the path",
            ),
            "smallest_flip_drift": Figure(
                defined(least),
                "",
                "smallest relative change of a single resistance that changes a step, to first order",
            ),
            "resistors_flipping_at_1_percent": Figure(
                len(self.flips(0.01)), "", "resistors that each change a step by a drift of 1 %"
            ),
        }

    def to_json(self) -> dict[str, Any]:
        """Return the result as a dictionary for JSON.

        Keys: the names of `figures`, each with a dictionary of ``value``, ``unit`` and ``definition``; ``weakest``:
        list of the ten most sensitive resistors, each with ``nodes`` (names of both nodes), ``drift`` (the resistor's
        `flip_drift`) and ``cell`` (index of the cell whose decision the resistor changes first).
        """
        worst = self.flips(np.finfo(np.float64).max)[:_WORST]
        names, cells = end_names(self.op.netlist, worst), self.cells[self.decision[worst]].tolist()
        weakest = [
            {"nodes": pair, "drift": drift, "cell": cell}
            for pair, drift, cell in zip(names, self.flip_drift[worst].tolist(), cells, strict=True)
        ]
        return {**super().to_json(), "weakest": weakest}


def voltage_sensitivity(op: OperatingPoint, weights: ArrayLike) -> NDArray[np.float64]:
    """Return the derivatives of a weighted sum of voltages by the natural log of every resistance, shape (resistors,).

    The sum is ``c V``; the derivatives are in volts.

    `op`: operating point, with node voltages ``V``; `weights` (nodes,): ``c``.  Nonlinear resistors follow the linear
    ones. Derivatives below their error bound are 0.  Raises InputError for weights of another shape, infinite weights,
    or a weight other than 0 at a floating node.
    """
    netlist = op.netlist
    c = np.asarray(weights, dtype=np.float64)
    if c.shape != (netlist.node_count,) or not np.isfinite(c).all():
        raise InputError(f"weights of shape {c.shape} must be {netlist.node_count} finite numbers, one per node")
    if c[op.floating].any():
        node = netlist.node_name(int(op.floating[np.argmax(c[op.floating] != 0)]))
        raise InputError(f"node {node} floats and has no voltage: give it the weight 0")
    sign, log_size = adjoint_of(op).derivatives(c)
    return np.asarray(sign * np.exp(log_size))


def analyse_sensitivity(op: OperatingPoint, cells: ArrayLike) -> Sensitivity:
    """Find the resistors whose drift (relative change) alters the robot's next cell; return them as a Sensitivity.

    `op`: operating point of the chip; `cells` (k, axes): indices of the cells in which the robot decides.
    """
    steps = steps_of(op)
    where, flat = _checked_cells(steps.cells.space, cells)
    adjoint = adjoint_of(op)
    count = len(adjoint.row)
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
    """Return the lowest neighbour of a cell, the second lowest cell, and two numbers ``gap`` and ``scale``.

    The second lowest cell lies ``gap exp(scale)`` volts above the lowest, counted towards the obstacle rail; it may be
    the cell itself.  Cells are given by flat indices (C order).  `steps`: voltage steps between neighbours; `cell`:
    flat index of the cell. Raises InputError if no neighbour is lower.
    """
    first, last = np.searchsorted(steps.cell, [cell, cell + 1])
    if not np.any(steps.sign[first:last] > 0):
        place = tuple(int(i) for i in np.unravel_index(cell, steps.cells.space.shape))
        raise InputError(
            f"cell {place} has no lower neighbour: no current leaves it, so that there is no step to change"
        )
    neighbour, log_volts = steps.neighbour[first:last], steps.log_volts[first:last]
    scale = float(log_volts.max())
    down = steps.sign[first:last] * np.exp(log_volts - scale)
    order = np.argsort(-down, kind="stable")
    best = int(neighbour[order[0]])
    others = [(float(down[k]), int(neighbour[k])) for k in order[1:].tolist() if down[k] > 0.0]
    second, runner_up = next(((volts, place) for volts, place in others if place != best), (0.0, cell))
    return best, runner_up, float(down[order[0]]) - second, scale


def _checked_cells(space: ConfigurationSpace, cells: ArrayLike) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the given cells without goal cells: cell indices (k, axes), and flat indices (k,) in C order.

    `space`: space of the chip; `cells`: array of cell indices.  Raises InputError for obstacle cells, or if all cells
    are goal cells.
    """
    where = cell_indices(space, cells).reshape(-1, space.ndim)
    code = space.cell[tuple(where.T)]
    where = where[code != Cell.GOAL]
    if np.any(code == Cell.OBSTACLE) or not len(where):
        raise InputError("every cell must be free (a path may end in a goal cell)")
    return where, np.ravel_multi_index(tuple(where.T), space.shape).astype(np.int64)


ENOUGH = 1e-5
"""Largest accepted error of a derivative, as a fraction of the largest derivative; beyond it, AccuracyError is raised.
"""

_RTOL = 1e-12
"""Largest accepted relative residual of solutions by the normwise linear solver."""
_EPS = float(np.finfo(np.float64).eps)


@dataclass(frozen=True, eq=False)
class Adjoint:
    """Factors and currents from which the derivatives of voltages around an operating point are computed.

    Linear resistors come first, then nonlinear ones.  `factors`: factors of the linearized circuit, None if no node
    voltage is unknown; `row` (resistors, 2): matrix rows of both ends of each resistor, -1 where the voltage is known;
    `conductance` (resistors,): small-signal conductances, in siemens; `log_amps` (resistors,): natural logarithm of the
    magnitude of the currents in amperes; `direction` (resistors,): sign of the currents from the first to the second
    end, -1, 0 or 1; `height` (n,): row voltages for 1 A into every row, plus their largest error, in volts.
    """

    factors: CircuitFactor | None
    row: NDArray[np.int32]
    conductance: NDArray[np.float64]
    log_amps: NDArray[np.float64]
    direction: NDArray[np.int8]
    height: NDArray[np.float64]

    def derivatives(self, c: NDArray[np.float64]) -> tuple[NDArray[np.int8], NDArray[np.float64]]:
        """Return the derivatives of the sum ``c V`` by the natural log of every resistance, as signs and logarithms.

        `c` (nodes,): weights of the node voltages ``V``.  Returns the sign (-1, 0 or 1) and the natural logarithm of
        the magnitude in volts, each of shape (resistors,).  Raises AccuracyError if an error may exceed 1e-5 of the
        largest derivative.
        """
        zero = np.zeros_like(self.direction), np.full(len(self.row), -np.inf)
        if self.factors is None:
            return zero
        row = self.factors.system.unknown
        rhs = np.bincount(row[row >= 0], c[row >= 0], self.factors.system.size).astype(np.float64)
        if not rhs.any():
            return zero
        scale = float(np.abs(rhs).max())
        for find in (self._normwise, self._entrywise):
            sign, log_across, log_error = find(self.factors, rhs / scale)
            log_size = self.log_amps + log_across
            error, largest = float((self.log_amps + log_error).max()), float(log_size.max())
            if error <= largest + np.log(ENOUGH):
                known = log_across > log_error
                signs = np.where(known, sign * self.direction, 0).astype(np.int8)
                return signs, np.asarray(np.where(known, log_size + np.log(scale), -np.inf))
        if self._is_at_rest_around(rhs):
            return zero
        raise AccuracyError(
            f"the derivatives with respect to resistances may be off by {np.exp(min(error - largest, 0.0)):.0e} of the "
            "largest of them: the conductances span too many orders of magnitude"
        )

    def _normwise(self, factors: CircuitFactor, rhs: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
        """Return the differences of the adjoint ``lambda = G^-1 rhs`` across resistors, with errors, from one solve.

        A difference is the first end minus the second.  `factors`: factors of the linearized circuit; `rhs` (n,):
        weights, divided by the largest magnitude.  The result is in the same scale: signs, natural logarithms of the
        magnitudes, and natural logarithms of the error bounds, each of shape (resistors,).
        """
        matrix = factors.system.laplacian
        try:
            x = factors.solve(rhs, rtol=_RTOL)
        except AccuracyError as error:
            x = np.asarray(error.best, dtype=np.float64)
        diagonal, edges = matrix.diagonal, matrix.edges
        coupled = diagonal * np.abs(x) + edges @ np.abs(x) + np.abs(rhs)
        residual = np.abs(rhs - (diagonal * x - edges @ x)) + 4.0 * _EPS * coupled
        return *self._across([Scaled.of(x)]), self._log_error(residual)

    def _entrywise(self, factors: CircuitFactor, rhs: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
        """Return the differences of the adjoint ``lambda = G^-1 rhs`` across resistors, with errors, from two solves.

        The positive and the negative part of `rhs` are solved separately, each with componentwise accuracy.  A
        difference is the first end minus the second.  `factors`: factors of the linearized circuit; `rhs` (n,):
        weights, divided by the largest magnitude.  The result is in the same scale: signs, natural logarithms of the
        magnitudes, and natural logarithms of the error bounds, each of shape (resistors,).
        """
        parts, residual, matrix = [], np.zeros(len(rhs)), factors.system.laplacian
        diagonal, edges = matrix.diagonal, matrix.edges
        bound = 0.0
        for part in (np.maximum(rhs, 0.0), np.maximum(-rhs, 0.0)):
            watch = ProgressMonitor()
            x, error = factors.factors.solve_nonnegative(part, watch=watch) if part.any() else (Scaled.of(part), 0.0)
            parts.append(x)
            residual += error * (diagonal * x.plain + edges @ x.plain + part)
            bound = max(bound, watch.bound)
        log_sum = np.append(np.logaddexp.reduce([x.log for x in parts]), -np.inf)
        log_sum = np.logaddexp(*log_sum[self.row.T])
        log_error = self._log_error(residual)
        if np.isfinite(bound):
            log_error = np.minimum(log_error, np.log(bound + _EPS) + log_sum)
        log_error[np.isneginf(log_sum)] = -np.inf  # parts that no current of `rhs` enters
        return *self._across(parts), log_error

    def _is_at_rest_around(self, rhs: NDArray[np.float64]) -> bool:
        """Return whether the adjoint ``lambda = G^-1 rhs`` is constant across every resistor that carries a current.

        The derivatives with respect to all resistances are then 0.  A part is a set of rows that resistors without
        current connect. The condition holds if each part with an entry of `rhs` (n,) other than 0 meets one of two
        conditions.  Either resistors without current connect the part to a known voltage, and no resistor at the part
        carries a current; or at most one row of the part has resistors with a current, and the entries of `rhs` in the
        part add up to 0.
        """
        size, resting = len(rhs), np.isneginf(self.log_amps)
        is_inner = (self.row >= 0).all(axis=1)
        ends = self.row[resting & is_inner]
        part = label_components(ends, size)
        is_held, is_active = np.zeros((2, size + 1), dtype=bool)  # last entry: nodes with a known voltage
        is_held[self.row[resting & ~is_inner]] = True
        is_active[self.row[~resting]] = True
        held, active, injected = (np.bincount(part, mask) for mask in (is_held[:-1], is_active[:-1], rhs != 0.0))
        is_shut = np.where(held > 0, active == 0, (active <= 1) & (np.bincount(part, rhs) == 0.0))
        return bool(is_shut[injected > 0].all())

    def _log_error(self, residual: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the natural log of the largest error of ``lambda`` across every resistor, shape (resistors,).

        `residual` (n,): bound on the magnitude of the residual of every row, which causes the error.
        """
        with np.errstate(divide="ignore"):
            energy = np.log(np.sum(self.height * residual**2))
        return np.asarray(0.5 * (energy - np.log(self.conductance)))

    def _across(self, parts: list[Scaled]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return sign and natural log of the magnitude of a solution's differences across resistors, each (resistors,).

        A difference is the first end minus the second.  `parts`: the solution, or two vectors whose difference is the
        solution, with one entry per row (n,).
        """
        hi, lo, e = (
            np.stack([np.append(getattr(x, name), 0)[self.row] for x in parts]) for name in ("hi", "lo", "exponent")
        )
        top = np.where(hi != 0.0, e, np.iinfo(np.int64).min).max(axis=(0, 2))
        shift = power(np.where(hi != 0.0, e, top[:, np.newaxis]) - top[:, np.newaxis])
        high, low = (np.subtract.reduce(np.subtract(*np.moveaxis(value * shift, 2, 0))) for value in (hi, lo))
        difference = high + low
        return np.sign(difference), logarithm(np.abs(difference), np.where(difference != 0.0, top, 0))


def adjoint_of(op: OperatingPoint, factors: CircuitFactor | None = None) -> Adjoint:
    """Return the Adjoint of an operating point, which computes derivatives of voltages.

    `op`: operating point; `factors`: factors of the circuit linearized at `op`, None to compute them.
    """
    signals = linearize(op)
    if factors is None:
        system = assemble(signals)
        factors = factor_circuit(system) if system.size else None
    row, height = np.full((len(signals.conductance), 2), -1, dtype=np.int32), np.zeros(0)
    if factors is not None:
        row = factors.system.unknown[ends_of(op.netlist)]
        height = np.abs(factors.solve(np.ones(factors.system.size)))
        height += 1e-6 * height.max()  # its largest error
    return Adjoint(
        factors=factors,
        row=row,
        conductance=signals.conductance,
        log_amps=np.concatenate([op.resistor_log_current, op.nonlinear_log_amps]),
        direction=np.concatenate([op.resistor_direction, op.nonlinear_direction]),
        height=height,
    )
