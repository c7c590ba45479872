"""Linear circuits: solve for the operating point, or factor the matrix for many right-hand sides."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.circuit.equations import ALWAYS_RECOVERED, Equations, assemble, components_of
from resgrid.circuit.extreme_values import is_extreme, solve_extreme
from resgrid.circuit.operating_point import OUT_OF_RANGE, BranchCurrents, OperatingPoint
from resgrid.circuit.postprocess import (
    DIRECTION_RESIDUAL,
    NodeValues,
    node_values,
    read_entrywise,
    read_normwise,
    values_above,
)
from resgrid.core.netlist import GROUND, Netlist
from resgrid.errors import AccuracyError, CircuitError
from resgrid.solvers.factors import EXACT_ROWS, Factor
from resgrid.solvers.laplacian import conductance_statistics
from resgrid.solvers.method_choice import factor_laplacian
from resgrid.solvers.progress import Progress, ProgressMonitor
from resgrid.solvers.refinement import CERTAIN, is_answer
from resgrid.solvers.scaled import unscaled
from resgrid.solvers.threads import SINGLE_THREAD, ThreadTeam

_LARGEST_ROUNDING = 1e-10
"""Limit on the rounding error of a sum of source voltages, as a fraction of the smallest source voltage.

Beyond the limit, the currents of circuits with more than 20,000 rows are also recovered, i.e. computed again without
cancellation.
"""

_LEAST_PLACES = -800
"""Smallest binary exponent of the largest driving current, in A, for which normwise solutions do not scale currents."""


def solve_linear(
    netlist: Netlist, *, accuracy: str, method: str, rtol: float, threads: int = 1, progress: Progress | None = None,
    unlimited: bool = False,
) -> OperatingPoint:  # fmt: skip
    """Return the operating point of a netlist without nonlinear resistors.

    `accuracy`: ``"direction"`` (componentwise) or ``"normwise"``; `method`: ``"auto"``, ``"direct"`` or
    ``"multigrid"``; `rtol`: largest backward error for ``"normwise"``; `threads`: largest number of threads;
    `progress`: function called after every iteration with the number of iterations, the relative residual norm, and the
    estimated remaining seconds or None; `unlimited`: whether voltages of extreme circuits may be infinite.  Raise
    CircuitError without an operating point, AccuracyError if the accuracy is not reached.

    The stages, whose wall-clock times are in `OperatingPoint.seconds`:

    1. ``assemble``: eliminate voltage sources and set up the nodal equations (`equations`).
    2. ``factor``: choose a method and factor the matrix (`resgrid.solvers`).
    3. ``substitute``: solve for the values of the nodes.
    4. ``read``: compute voltages, potentials and branch currents (`postprocess`).
    5. ``balance``: recover currents that cancel, if there may be any (`current_recovery`); not for ``"normwise"``.
    6. Check the accuracy, and add the currents of floating components.
    """
    with ThreadTeam(threads) as team:
        run = _Run(method, accuracy, team, ProgressMonitor(progress), {})
        with run.timed("assemble"), np.errstate(all="ignore"):  # extreme values may overflow
            system = assemble(netlist)
        if is_extreme(netlist):
            with run.timed("balance"):
                point = replace(solve_extreme(system), seconds=run.seconds)
            if not unlimited and np.isinf(point.voltage).any():
                raise CircuitError(OUT_OF_RANGE)
        elif accuracy == "normwise":
            point = _solve_normwise(system, run, rtol)
        else:
            solution = _substitute_and_read(system, run)
            if _may_cancel(system, solution):
                solution = _recover(system, run, solution)
            _check_accuracy(solution)
            point = solution.point
    if _is_driven_where_floating(system):
        floating, resistors, sources = _floating_components(system)
        currents = solve_linear(floating, accuracy=accuracy, method=method, rtol=rtol, unlimited=True).readings
        point = replace(point, _currents=_merged(point.readings, currents, resistors, sources))
    return point


class _Run(NamedTuple):
    """Options and progress of one solve.

    `method`: ``"auto"``, ``"direct"`` or ``"multigrid"``; `accuracy`: ``"normwise"`` or ``"direction"``
    (componentwise); `team`: threads; `watch`: counts iterations and records errors; `seconds`: wall-clock time of every
    finished stage by its name, filled in by `timed`.
    """

    method: str
    accuracy: str
    team: ThreadTeam
    watch: ProgressMonitor
    seconds: dict[str, float]

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Measure the wall-clock time of the block, and store it in `seconds` under the name `stage`."""
        start = time.perf_counter()
        yield
        self.seconds[stage] = time.perf_counter() - start

    def factor(self, system: Equations) -> Factor | None:
        """Return the factors of the matrix of the equations, or None if the equations have no rows."""
        with self.timed("factor"):
            if not system.size:
                return None
            return factor_laplacian(system.laplacian, self.method, accuracy=self.accuracy, threads=self.team)


class _Solution(NamedTuple):
    """A componentwise solution, and the quantities that decide whether it is accurate.

    `point`: operating point; `values`: voltage of every node from the nearer rail; `residual` (nodes,): KCL residual
    as a fraction of the current through the node (half the sum of the magnitudes of its currents); `imprecise`: whether
    currents above 1e-7 of the current through a node have few correct digits; `error_bound`: bound on the errors of
    voltages relative to the largest one, and of currents relative to the current through a node, 0 if no bound is
    computed; `recovered`: whether the currents were computed again without cancellation, with a proof of their own.
    """

    point: OperatingPoint
    values: NodeValues
    residual: NDArray[np.float64]
    imprecise: bool
    error_bound: float
    recovered: bool = False


def _solve_normwise(system: Equations, run: _Run, rtol: float) -> OperatingPoint:
    """Return the operating point with a normwise backward error of at most `rtol`; raise AccuracyError if it is larger.

    `system`: equations; `run`: options of the solve.
    """
    factors = run.factor(system)
    name, threads = (factors.name, factors.threads.size) if factors else ("none", 1)
    # Subnormal currents have too few digits for the iteration, so that small ones are multiplied by a power of two.
    places = max(_LEAST_PLACES - int(np.frexp(np.abs(system.drive).max(initial=0.0))[1]), 0)

    def read(x: NDArray[np.float64]) -> OperatingPoint:
        watch = run.watch
        return read_normwise(
            system, x, method=name, seconds=run.seconds, iterations=watch.iterations, backward_error=watch.error,
            threads=threads,
        )  # fmt: skip

    with run.timed("substitute"):
        try:
            x = factors.solve(_shifted(system.drive, places), rtol=rtol, watch=run.watch) if factors else np.zeros(0)
        except AccuracyError as error:
            raise AccuracyError(str(error), read(_shifted(np.asarray(error.best, np.float64), -places))) from None
        del factors  # free the memory
    with run.timed("read"):
        return read(_shifted(x, -places))


def _shifted(values: NDArray[np.float64], places: int) -> NDArray[np.float64]:
    """Return ``values * 2**places``, shape (n,); `values` itself for 0 places."""
    return np.ldexp(values, places) if places else values


def _substitute_and_read(system: Equations, run: _Run) -> _Solution:
    """Solve with componentwise accuracy; return the operating point with its accuracy, which is not yet checked.

    `system`: equations; `run`: options of the solve.
    """
    factors = run.factor(system)
    name, team = (factors.name, factors.threads) if factors else ("none", SINGLE_THREAD)
    with run.timed("substitute"):
        values = node_values(system, factors, run.watch, team)
        del factors  # free the memory
    with run.timed("read"):
        point, residual, imprecise = read_entrywise(
            system, values, team, method=name, seconds=run.seconds, threads=team.size
        )
    has_both_signs = point.log_drop is None and point.potential is None
    entry_error = np.inf if has_both_signs else run.watch.bound + float(np.finfo(np.float64).eps)
    point = replace(point, iterations=run.watch.iterations, backward_error=run.watch.error, entry_error=entry_error)
    return _Solution(point, values, residual, imprecise, values.error_bound)


def _tiny_currents(system: Equations, point: OperatingPoint) -> BranchCurrents | None:
    """Return the branch currents of a circuit with two rails if some are outside the range of doubles, else None."""
    return point.readings if system.rails is not None and point.readings.scaled[1].any() else None


def _may_cancel(system: Equations, solution: _Solution) -> bool:
    """Return whether currents may have lost their digits to cancellation and can be recovered.

    To recover currents is to compute them again without cancellation.  `system`: equations; `solution`: solution before
    the recovery.  Grids with currents outside the range of doubles are not recovered.
    """
    if system.netlist.space_map is not None and _tiny_currents(system, solution.point) is not None:
        return False
    return solution.imprecise or solution.error_bound > CERTAIN or _suggests_cancellation(system, solution.point)


def _suggests_cancellation(system: Equations, point: OperatingPoint) -> bool:
    """Return whether voltages or currents may be small differences of large values.

    `system`: equations; `point`: operating point, before the recovery of currents, i.e. before currents are computed
    again without cancellation.  The result is True for circuits that have at most 500 nodes and were not compiled from
    a space, for violations of KCL above 1e-6 of the current through the node, and for floating sources that drive
    currents.  In circuits of at most 20,000 rows it is also True if voltage sources are in series, if sources drive
    currents of both signs, or if the smallest conductance is below 1e-9 times the largest.  In larger circuits it is
    also True if the rounding error of a sum of source voltages is above 1e-10 of the smallest source voltage.
    """
    forest, volts = system.forest, np.abs(system.netlist.source_volts)
    rounding, few = float(np.abs(forest.rounding).max(initial=0.0)), system.size <= EXACT_ROWS
    if forest.largest_offset > 0.0 or point.kcl_residual > DIRECTION_RESIDUAL:
        return True
    if system.netlist.space_map is None and system.netlist.node_count <= ALWAYS_RECOVERED:
        return True
    if few and ((system.rails is None and point.potential is None) or np.any(forest.parent > GROUND)):
        return True
    if rounding > 0.0 and (few or rounding > _LARGEST_ROUNDING * volts[volts > 0.0].min()):
        return True
    return bool(few and system.size) and conductance_statistics(system.laplacian).is_stiff


def _recover(system: Equations, run: _Run, solution: _Solution) -> _Solution:
    """Return the solution with currents computed again without cancellation, or the given one if that fails.

    In a circuit with two rails, an accurate given solution is also returned if the new currents violate KCL more than
    its own, and by more than 1e-6 of the current through a node.

    `system`: equations; `run`: options of the solve; `solution`: solution before the recovery.
    """
    from resgrid.circuit.current_recovery import recover_currents

    tiny, rails, watch = _tiny_currents(system, solution.point), system.rails, run.watch
    team = run.team if solution.point.threads > 1 else SINGLE_THREAD
    with run.timed("balance"):
        found, direct = recover_currents(system)
        if found is None or not (tiny is None or np.isfinite(found.entry_error)):
            return solution
        first, values = solution.point, solution.values
        if rails is None:
            values = values_above(system, found.heights)
        elif not watch.bound <= CERTAIN:
            values = node_values(system, direct, ProgressMonitor(), team)
        point, residual, imprecise = read_entrywise(
            system, values, team, found, tiny, method=first.method, seconds=run.seconds, threads=first.threads
        )
        proved = rails is not None and is_answer(watch.error, watch.bound)
        if proved and point.kcl_residual > max(first.kcl_residual, DIRECTION_RESIDUAL):
            return solution
    entry_error = first.entry_error if rails is not None else min(first.entry_error, found.entry_error)
    point = replace(point, iterations=first.iterations, backward_error=first.backward_error, entry_error=entry_error)
    return _Solution(point, values, residual, imprecise, found.error_bound, recovered=True)


def _check_accuracy(solution: _Solution) -> None:
    """Raise AccuracyError if the solve did not converge, currents may cancel, or the field is not direction-safe.

    `solution`: solution with the residuals and error bounds that are checked.
    """
    point, residual = solution.point, solution.residual
    if not solution.recovered and not is_answer(point.backward_error, point.entry_error):
        raise AccuracyError(
            f"method {point.method!r} reached a componentwise backward error of only {point.backward_error:.1e}: the "
            "potential, or the conductances, span more orders of magnitude than it can represent; use another method, "
            "or accuracy = 'normwise'",
            point,
        )
    if solution.error_bound > DIRECTION_RESIDUAL:
        raise AccuracyError(
            f"currents nearly cancel: their errors may be {solution.error_bound:.1e} of the current through a node (at "
            f"most {DIRECTION_RESIDUAL:g} is allowed); check the elements that tie the circuit to its rails, or use "
            "accuracy = 'normwise'",
            point,
        )
    if not point.kcl_residual <= DIRECTION_RESIDUAL:
        worst = int(np.argmax(residual))
        raise AccuracyError(
            f"the field is not direction-safe: at node {point.netlist.node_name(worst)} KCL is violated by "
            f"{residual[worst]:.1e} of the current through it (at most {DIRECTION_RESIDUAL:g} is allowed); use another "
            "method, or accuracy = 'normwise'",
            point,
        )


def _is_driven_where_floating(system: Equations) -> bool:
    """Return whether current sources or voltage sources touch floating nodes."""
    if not len(system.floating):
        return False
    netlist, forest = system.netlist, system.forest
    ends = forest.order[forest.height != 0], netlist.current_nodes[netlist.current_amps != 0].ravel()
    return bool(np.isin(np.concatenate(ends), system.floating).any())


def _floating_components(system: Equations) -> tuple[Netlist, NDArray[np.bool_], NDArray[np.bool_]]:
    """Return the floating components as a netlist, and masks of their resistors (resistors,) and sources (sources,).

    A source of 0 V connects one node of each component to ground.  The source currents into a component add up to zero,
    so that this connection carries no current.  Ends of current sources in other components become ground.
    """
    netlist = system.netlist
    resistors, sources = (
        np.isin(ends[:, 0], system.floating) for ends in (netlist.resistor_nodes, netlist.source_nodes)
    )
    component = components_of(netlist, netlist.resistor_nodes, system.forest).of_node
    pins = system.floating[np.unique(component[system.floating], return_index=True)[1]]
    ends = np.concatenate([netlist.source_nodes[sources], np.outer(pins, [1, 0])])
    volts = np.append(netlist.source_volts[sources], 0.0 * pins)
    inside = np.isin(netlist.current_nodes, system.floating)
    touching = inside.any(axis=1)
    floating = Netlist(
        netlist.node_count, netlist.resistor_nodes[resistors], netlist.conductance[resistors], ends, volts,
        current_nodes=np.where(inside, netlist.current_nodes, GROUND)[touching],
        current_amps=netlist.current_amps[touching],
    )  # fmt: skip
    return floating, resistors, sources


def _merged(
    grounded: BranchCurrents, floating: BranchCurrents, resistors: NDArray[np.bool_], sources: NDArray[np.bool_]
) -> BranchCurrents:
    """Return the currents of the whole circuit: its grounded part, and its floating components.

    `grounded`: currents of the circuit without its floating components, in which these have the current 0; `floating`:
    currents of these components; `resistors` (resistors,), `sources` (sources,): whether the resistor or voltage source
    is in a floating component.
    """
    amps, exponent, through = grounded.scaled[0].copy(), grounded.scaled[1].copy(), grounded.source_current.copy()
    amps[resistors], exponent[resistors] = floating.scaled
    through[sources] = floating.source_current[: np.count_nonzero(sources)]
    residual, power = max(grounded.kcl_residual, floating.kcl_residual), grounded.power + floating.power
    return BranchCurrents(unscaled(amps, exponent), (amps, exponent), through, power, residual)


@dataclass(frozen=True, eq=False)
class CircuitFactor:
    """Equations of a circuit and the factors of their matrix.

    Returned by `resgrid.factorize`; one factorization serves any number of right-hand sides.

    Attributes
    ----------
    system : Equations
        Nodal equations: the row of every node, the conductances in siemens and the injected currents in amperes.
    factors : Factor
        Factors of the matrix ``system.laplacian``, shape (n, n), in siemens.

    Examples
    --------
    >>> divider = rg.Netlist(3, [[1, 2], [2, 0]], [1e-3, 3e-3], source_nodes=[[1, 0]], source_volts=[2.0])
    >>> factor = rg.factorize(divider)
    >>> factor
    <CircuitFactor of <Netlist of 3 nodes: 2 resistors, 1 voltage source>: 1 rows, direct>
    >>> factor.solve([1e-3]).round(6)
    array([0.25])
    """

    system: Equations
    factors: Factor

    def __repr__(self) -> str:
        return f"<CircuitFactor of {self.system.netlist!r}: {self.system.size} rows, {self.factors.name}>"

    def solve(self, rhs: ArrayLike, *, rtol: float = 1e-10, guess: ArrayLike | None = None) -> NDArray[np.float64]:
        """Return the solution of the equations for a right-hand side.

        Parameters
        ----------
        rhs : array_like of float, shape (n,)
            Currents into the nodes of the rows, in amperes, in place of those of the sources (``system.drive``).
        rtol : float
            Largest normwise backward error of the solution.
        guess : array_like of float, shape (n,), optional
            Initial value of an iterative method, in volts.

        Returns
        -------
        ndarray of float64, shape (n,)
            Voltages of the nodes of the rows above the lowest known voltage, ``system.reference``, in volts.

        Raises
        ------
        InputError
            If the shape of `rhs` is wrong.
        """
        return self.factors.solve(rhs, rtol=rtol, guess=guess)


def factor_circuit(system: Equations, method: str = "auto") -> CircuitFactor:
    """Return the factored matrix of the equations, for normwise and componentwise solves.

    `system`: equations; `method`: ``"auto"``, ``"direct"`` or ``"multigrid"``.
    """
    factors = factor_laplacian(system.laplacian, method)
    return CircuitFactor(replace(system, laplacian=factors.laplacian), factors)
