"""Solve a linear circuit: assemble, factor, substitute, read off, and refuse what is not as accurate as promised.

Or factor it once, for many right-hand sides.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.circuit.equations import Equations, assemble, parts_of
from resgrid.circuit.operating_point import BranchCurrents, OperatingPoint
from resgrid.circuit.postprocess import DIRECTION_RESIDUAL, node_values, read_entrywise, read_normwise, values_above
from resgrid.core.netlist import GROUND, Netlist
from resgrid.errors import AccuracyError
from resgrid.solvers.factors import EXACT_ROWS, Factor
from resgrid.solvers.laplacian import conductance_statistics
from resgrid.solvers.method_choice import factor_laplacian
from resgrid.solvers.progress import Progress, ProgressMonitor
from resgrid.solvers.refinement import CERTAIN, is_answer
from resgrid.solvers.scaled import unscaled
from resgrid.solvers.threads import SINGLE_THREAD, ThreadTeam

_LOST = 1e-10
"""Share of the smallest source's voltage that rounding may leave of a sum."""

_FEW = 500
"""Number of nodes up to which circuits are balanced in any case, unless they are grids: it takes some milliseconds."""

_STIFF = 1e-9
"""Ratio of conductances from which the rounding of the large ones may hide what the small ones carry."""


def solve_linear(
    netlist: Netlist, *, accuracy: str, method: str, rtol: float, threads: int = 1, progress: Progress | None = None
) -> OperatingPoint:
    """Find the operating point of a netlist without nonlinear resistors; options and errors are `resgrid.solve`'s."""
    seconds: dict[str, float] = {}
    with ThreadTeam(threads) as team:
        with _timed(seconds, "assemble"):
            system = assemble(netlist)
        point = _solved(system, seconds, accuracy, method, rtol, team, ProgressMonitor(progress))
    driven = system.forest.order[system.forest.height != 0], netlist.current_nodes[netlist.current_amps != 0].ravel()
    if not np.isin(np.concatenate(driven), system.floating).any():
        return point
    some = [np.isin(ends[:, 0], system.floating) for ends in (netlist.resistor_nodes, netlist.source_nodes)]
    loops = _tied_parts(system, *some)
    found = solve_linear(loops, accuracy=accuracy, method=method, rtol=rtol).readings
    return replace(point, ammeters=_joined(point.readings, found, *some))


def _solved(
    system: Equations,
    seconds: dict[str, float],
    accuracy: str,
    method: str,
    rtol: float,
    team: ThreadTeam,
    watch: ProgressMonitor,
) -> OperatingPoint:
    with _timed(seconds, "factor"):
        factors = factor_laplacian(system.laplacian, method, accuracy=accuracy, threads=team) if system.size else None
    team = factors.threads if factors else SINGLE_THREAD
    told: dict[str, Any] = {"method": factors.name if factors else "none", "seconds": seconds, "threads": team.size}
    if accuracy == "normwise":

        def read(x: NDArray[np.float64]) -> OperatingPoint:
            return read_normwise(system, x, iterations=watch.iterations, backward_error=watch.error, **told)

        with _timed(seconds, "substitute"):
            try:
                x = factors.solve(system.drive, rtol=rtol, watch=watch) if factors else np.zeros(0)
            except AccuracyError as error:
                raise AccuracyError(str(error), read(np.asarray(error.best, dtype=np.float64))) from None
            del factors
        with _timed(seconds, "read"):
            return read(x)
    with _timed(seconds, "substitute"):
        values = node_values(system, factors, watch, team)
        del factors
    with _timed(seconds, "read"):
        point, residual, faint = read_entrywise(system, values, team, **told)
    signed = point.log_drop is None and point.potential is None
    bound = np.inf if signed else watch.bound + np.finfo(np.float64).eps
    doubt, balanced = values.doubt, False
    deep = point.readings if system.rails is not None and point.readings.scaled[1].any() else None
    may_balance = deep is None or system.netlist.cell_map is None
    if may_balance and (faint or doubt > CERTAIN or _asks_for_balance(system, point)):
        from resgrid.circuit.current_recovery import balance

        with _timed(seconds, "balance"):
            found, direct = balance(system)
            if found is not None and (deep is None or np.isfinite(found.entry_error)):
                proved = system.rails is not None and is_answer(watch.error, watch.bound)
                if system.rails is None:
                    values = values_above(system, found.heights)
                elif not watch.bound <= CERTAIN:
                    values = node_values(system, direct, ProgressMonitor(), team)
                again = read_entrywise(system, values, team, found, deep, **told)
                if not proved or again[0].kcl_residual <= max(point.kcl_residual, DIRECTION_RESIDUAL):
                    (point, residual, _), doubt, balanced = again, found.doubt, True
                    bound = bound if system.rails is not None else min(bound, found.entry_error)
    point = replace(point, iterations=watch.iterations, backward_error=watch.error, entry_error=bound)
    if not balanced and not is_answer(point.backward_error, point.entry_error):
        raise AccuracyError(
            f"method {point.method!r} reached a componentwise backward error of {point.backward_error:.1e} only: the "
            "potential falls, or the conductances differ, by more decades than it can hold; use another method, or "
            "accuracy = 'normwise'",
            point,
        )
    _check_direction(point, residual, doubt)
    return point


def _asks_for_balance(system: Equations, point: OperatingPoint) -> bool:
    """Return whether voltages and currents may be small differences of large ones, which rounding hides.

    Every small circuit is balanced, unless it is a grid of cells, and every circuit whose currents do not add up or in
    which floating sources drive currents around.  Others are balanced if sources in series add up to rounded voltages,
    and, up to some size, if currents of both signs drive them or conductances differ by many orders of magnitude.
    """
    forest, volts = system.forest, np.abs(system.netlist.source_volts)
    lost, few = float(np.abs(forest.rest).max(initial=0.0)), system.size <= EXACT_ROWS
    if forest.lift > 0.0 or point.kcl_residual > DIRECTION_RESIDUAL:
        return True
    if system.netlist.cell_map is None and system.netlist.node_count <= _FEW:
        return True
    if few and ((system.rails is None and point.potential is None) or np.any(forest.above > GROUND)):
        return True
    if lost > 0.0 and (few or lost > _LOST * volts[volts > 0.0].min()):
        return True
    if not (few and system.size):
        return False
    found = conductance_statistics(system.laplacian)
    return bool(found.smallest < _STIFF * found.largest)


def _tied_parts(system: Equations, resistors: NDArray[np.bool_], sources: NDArray[np.bool_]) -> Netlist:
    """The resistors and sources of what floats, each part tied to ground at one of its nodes.

    The currents of current sources into a part add up to zero, so that nothing flows through its tie; their ends in
    other places are ground here.
    """
    netlist, part = system.netlist, parts_of(system.netlist, system.netlist.resistor_nodes, system.forest).of_node
    pins = system.floating[np.unique(part[system.floating], return_index=True)[1]]
    ends = np.concatenate([netlist.source_nodes[sources], np.outer(pins, [1, 0])])
    volts = np.append(netlist.source_volts[sources], 0.0 * pins)
    inside = np.isin(netlist.current_nodes, system.floating)
    fed = inside.any(axis=1)
    return Netlist(
        netlist.node_count, netlist.resistor_nodes[resistors], netlist.conductance[resistors], ends, volts,
        current_nodes=np.where(inside, netlist.current_nodes, GROUND)[fed], current_amps=netlist.current_amps[fed],
    )  # fmt: skip


def _joined(
    whole: BranchCurrents, found: BranchCurrents, resistors: NDArray[np.bool_], sources: NDArray[np.bool_]
) -> BranchCurrents:
    """Readings with those of some resistors and sources, which are 0 in the whole."""
    amps, exponent, through = whole.scaled[0].copy(), whole.scaled[1].copy(), whole.source_current.copy()
    amps[resistors], exponent[resistors] = found.scaled
    through[sources] = found.source_current[: np.count_nonzero(sources)]
    residual = max(whole.kcl_residual, found.kcl_residual)
    return BranchCurrents(unscaled(amps, exponent), (amps, exponent), through, whole.power + found.power, residual)


@contextmanager
def _timed(seconds: dict[str, float], stage: str) -> Iterator[None]:
    start = time.perf_counter()
    yield
    seconds[stage] = time.perf_counter() - start


def _check_direction(point: OperatingPoint, residual: NDArray[np.float64], doubt: float) -> None:
    """Refuse an answer that is not direction-safe, or whose currents may be off by a share of others."""
    if doubt > DIRECTION_RESIDUAL:
        raise AccuracyError(
            f"currents nearly cancel: they may be off by {doubt:.1e} of what flows through a node (at most "
            f"{DIRECTION_RESIDUAL:g} is allowed); check what ties the circuit to its rails, or use accuracy = "
            "'normwise'",
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


@dataclass(frozen=True, eq=False)
class CircuitFactor:
    """A circuit's equations and the factors of their matrix.

    `system`: which node has which row, and what drives the rows; `factors`: of ``system.laplacian``.
    """

    system: Equations
    factors: Factor

    def __repr__(self) -> str:
        return f"<CircuitFactor of {self.system.netlist!r}: {self.system.size} rows, {self.factors.name}>"

    def solve(self, rhs: ArrayLike, *, rtol: float = 1e-10, guess: ArrayLike | None = None) -> NDArray[np.float64]:
        """Solve to a normwise backward error.  Shapes: `rhs` (n,), `guess` (n,); returns (n,)."""
        return self.factors.solve(rhs, rtol=rtol, guess=guess)


def factor_circuit(system: Equations, method: str = "auto") -> CircuitFactor:
    """Factor the matrix of a circuit's equations, for answers of either accuracy."""
    factors = factor_laplacian(system.laplacian, method)
    return CircuitFactor(replace(system, laplacian=factors.laplacian), factors)
