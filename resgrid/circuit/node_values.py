"""Entrywise answers: every node is counted from the nearer rail, so that small differences keep their digits.

Where a circuit hangs between two rails, the drop ``u`` from the high one is solved for; the height ``phi = 1 - u``
above the low one is what is left of it, or a solution of its own where that would be a small difference somewhere.

Currents of both signs are solved for apart, and either solution is right entry by entry, which says little of their
difference.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.equations import Equations
from resgrid.solvers.extended import Scaled, logarithm, power
from resgrid.solvers.factor import Factor
from resgrid.solvers.laplacian import Rails
from resgrid.solvers.monitor import Watch
from resgrid.solvers.team import Team

_LEAST_REST = 1e-3
"""Smallest height above the low rail, as a share of both rails' distance, that is read off the drop."""


@dataclass(frozen=True, eq=False)
class NodeValues:
    """A value for every node, counted from one rail, or from the nearer one of two.

    `value` (nodes,): 0 where the node floats; `down` (nodes,): whether the value is a drop from the high rail, 1 unit
    above the low one; `zero, volts`: voltage of the low (or only) rail, and volts of a unit; negative where values
    grow as voltages fall; `noise`: relative difference of two values counted upwards below which it is noise;
    ``value.noise`` is that of drops; `doubt`: by how much any value may be off at most, relative to the largest,
    where currents of both signs drive the circuit; of all others nothing is said here.
    """

    value: Scaled
    down: NDArray[np.bool_]
    zero: float
    volts: float
    noise: float
    doubt: float = 0.0

    @property
    def height(self) -> NDArray[np.float64]:
        """Plain heights above the low rail, in units."""
        plain = self.value.plain
        return np.where(self.down, 1.0 - plain, plain)


def node_values(system: Equations, factors: Factor | None, watch: Watch, team: Team) -> NodeValues:
    """Solve for all that the currents of a circuit are read off."""
    if system.rails is not None:
        return _between(system, system.rails, *_drop_and_height(system.rails, factors, watch, team), team)
    drive = system.drive
    if not np.any(drive < 0.0):
        (rising,) = _solved(factors, [drive], watch, team)
        return _above(system, rising, 1.0, team)
    if not np.any(drive > 0.0):
        (falling,) = _solved(factors, [np.abs(drive)], watch, team)
        return _above(system, falling, -1.0, team)
    assert factors is not None
    rising, falling = _solved(factors, [np.maximum(drive, 0.0), np.maximum(-drive, 0.0)], watch, team)
    difference = minus(rising, falling)
    doubt = watch.bound * quotient([rising, falling], difference)
    return replace(_above(system, difference, 1.0, team), doubt=doubt)


def values_above(system: Equations, volts: NDArray[np.float64], above: NDArray[np.float64], team: Team) -> NodeValues:
    """Values of all nodes from the heights of rows above every rail.  Shapes: `volts` (rails,), `above` (n, rails)."""
    rails = system.rails
    if rails is not None:
        span = rails.high - rails.low
        up, down = (above[:, int(np.argmin(np.abs(volts - rail)))] / span for rail in (rails.low, rails.high))
        return _between(system, rails, Scaled.of(-down), Scaled.of(up), team)
    nearest = np.abs(above).argmin(axis=1)
    x = (volts - system.reference)[nearest] + np.take_along_axis(above, nearest[:, None], axis=1)[:, 0]
    sign = -1.0 if np.all(x <= 0.0) else 1.0
    return _above(system, Scaled.of(sign * x), sign, team)


def _drop_and_height(rails: Rails, factors: Factor | None, watch: Watch, team: Team) -> tuple[Scaled, Scaled | None]:
    """The drop from the high rail, and the height above the low one where it is no mere rest of the drop.

    All that flows into the low rail comes from the high one: ``to_low * height`` is at most the sum of ``to_high``.
    Where that says that both are needed, they are solved at once.
    """
    to_low = rails.to_low
    if team.size > 1 and (to_high := rails.to_high).sum() < _LEAST_REST * to_low.max(initial=0.0):
        drop, height = _solved(factors, [to_low, to_high], watch, team)
        return drop, None if _leaves_rest(drop) else height
    (drop,) = _solved(factors, [to_low], watch, team)
    return drop, None if _leaves_rest(drop) else _solved(factors, [rails.to_high], watch, team)[0]


def _leaves_rest(drop: Scaled) -> bool:
    """Whether the height ``1 - drop`` is nowhere a small difference."""
    return bool(drop.plain.max(initial=0.0) < 1.0 - _LEAST_REST)


def _solved(factors: Factor | None, currents: list[NDArray[np.float64]], watch: Watch, team: Team) -> list[Scaled]:
    """Solve for right-hand sides of one sign each, side by side; an interrupt stops all."""

    def one(rhs: NDArray[np.float64]) -> Scaled:
        if factors is None or not rhs.any():
            return Scaled.of(np.zeros(len(rhs)))
        try:
            return factors.solve_nonnegative(rhs, watch=watch)[0]
        except KeyboardInterrupt:
            watch.stop()
            raise

    return team.together([partial(one, rhs) for rhs in currents])


def _between(system: Equations, rails: Rails, drop: Scaled, height: Scaled | None, team: Team) -> NodeValues:
    """Spread drops, and heights where they were solved for, over the nodes."""
    from resgrid.circuit.kernels import from_nearer_rail

    nodes = len(system.unknown)
    out, down = _zeros(nodes), np.zeros(nodes, dtype=np.bool_)
    own = height if height is not None else _zeros(0)
    known = system.known_voltages()

    def spread(piece: slice) -> None:
        row = system.unknown[piece]
        from_nearer_rail(row, known[piece], rails.low, rails.high, drop, own, out.at(piece), down[piece])

    team.over(nodes, spread)
    value = Scaled(out.hi, out.lo, out.exponent, drop.noise)
    noise = height.noise if height is not None else drop.noise / _LEAST_REST
    return NodeValues(value, down, rails.low, rails.high - rails.low, noise)


def _above(system: Equations, rows: Scaled, volts: float, team: Team) -> NodeValues:
    """Spread heights above the reference over the nodes."""
    from resgrid.circuit.kernels import from_one_rail

    nodes, forest = len(system.unknown), system.forest
    out, known = _zeros(nodes), system.known_voltages()

    def spread(piece: slice) -> None:
        from_one_rail(system.unknown[piece], known[piece], system.reference, volts, rows, out.at(piece))

    team.over(nodes, spread)
    lifted = (forest.height != 0) & (system.unknown[forest.order] >= 0)
    if lifted.any():
        # Floating sources occur only in circuits without two rails, whose values do not leave the range of a double.
        node = forest.order[lifted]
        out.hi[node] = out.hi[node] * power(out.exponent[node]) + forest.height[lifted] / volts
        out.lo[node] = out.exponent[node] = 0
    value = Scaled(out.hi, out.lo, out.exponent, rows.noise)
    return NodeValues(value, np.zeros(nodes, dtype=np.bool_), system.reference, volts, rows.noise)


def _zeros(nodes: int) -> Scaled:
    return Scaled.of(np.zeros(nodes))


CERTAIN = 1e-9
"""Errors relative to the largest value that need no closer look."""


def minus(a: Scaled, b: Scaled) -> Scaled:
    """``a - b``; all of shape (n,)."""
    from resgrid.solvers.refine_kernels import correct

    hi, lo, exponent = a.hi.copy(), a.lo.copy(), a.exponent.copy()
    correct(hi, lo, exponent, -b.hi, b.exponent)
    correct(hi, lo, exponent, -b.lo, b.exponent)
    return Scaled(hi, lo, exponent)


def quotient(parts: list[Scaled], x: Scaled) -> float:
    """The largest value of any part relative to that of ``x``; 0 where all parts vanish."""
    largest, most = _largest_log(x), max(_largest_log(part) for part in parts)
    with np.errstate(over="ignore"):
        return 0.0 if most == -np.inf else float(np.exp(most - largest))


def _largest_log(values: Scaled) -> float:
    return float(logarithm(np.abs(values.hi), values.exponent).max(initial=-np.inf))
