"""Derivatives of node voltages with respect to resistances, none of them noise.

The adjoint network (Director & Rohrer 1969) is for resistors the network itself: with ``G lambda = c`` the functional
``F = c . V`` changes by ``I_k (lambda_a - lambda_b)`` for a relative rise of the resistance ``k`` between nodes ``a``
and ``b`` that carries the current ``I_k``.  One solution gives all derivatives.

Far from where ``c`` asks, ``lambda`` falls by as many decades as the currents grow: an error that is small beside the
largest ``lambda`` would there be a large derivative.  So every difference of ``lambda`` has a bound on its error.  A
residual ``r`` leaves an error ``e`` with the energy ``sum g_k (e_a - e_b)^2 = r . G^-1 r``, and as ``G^-1`` has no
negative entry that is at most ``sum h_i r_i^2`` with ``G h = 1`` (Schur's test).  Where that proves too little, both
signs of ``c`` are solved for apart, entry by entry.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import cast

import numpy as np
from numpy.typing import NDArray

from resgrid.die import ends_of
from resgrid.errors import AccuracyError
from resgrid.nodal.factors.factor import Factor
from resgrid.nodal.methods import factor_system
from resgrid.nodal.operating_point import OperatingPoint
from resgrid.nodal.scaled import Scaled, logarithm, power
from resgrid.nodal.secant import small_signal
from resgrid.nodal.system import assemble
from resgrid.nodal.watch import Watch

ENOUGH = 1e-5
"""Error of derivatives, relative to the largest of them."""

_RTOL = 1e-12
_EPS = float(np.finfo(np.float64).eps)


@dataclass(frozen=True, eq=False)
class Adjoint:
    """A circuit made ready for derivatives around an operating point.

    `factors`: of its small signals; None where the rails hold every node; `ends` (resistors, 2): nodes of the
    resistors, nonlinear ones last; `conductance` (resistors,): theirs for small signals, in siemens; `log_amps`
    (resistors,): natural logarithm of their currents, in amperes; `direction` (resistors,): sign of these; `height`
    (n,): ``G^-1`` times 1 A in every row, in volts.
    """

    factors: Factor | None
    ends: NDArray[np.int32]
    conductance: NDArray[np.float64]
    log_amps: NDArray[np.float64]
    direction: NDArray[np.int8]
    height: NDArray[np.float64]

    def derivatives(self, c: NDArray[np.float64]) -> tuple[NDArray[np.int8], NDArray[np.float64]]:
        """Derivatives of ``c . V`` with respect to the logarithm of every resistance.

        Shapes: `c` (nodes,); returns `sign` (resistors,), `log_size` (resistors,).
        """
        nothing = np.zeros_like(self.direction), np.full(len(self.ends), -np.inf)
        if self.factors is None:
            return nothing
        row = self.factors.system.unknown
        rhs = np.bincount(row[row >= 0], c[row >= 0], self.factors.system.size).astype(np.float64)
        if not rhs.any():
            return nothing
        scale = float(np.abs(rhs).max())
        for find in (self._quickly, self._by_entry):
            sign, log_across, log_doubt = find(self.factors, rhs / scale)
            log_size = self.log_amps + log_across
            doubt, largest = float((self.log_amps + log_doubt).max()), float(log_size.max())
            if doubt <= largest + np.log(ENOUGH):
                known = log_across > log_doubt
                signs = np.where(known, sign * self.direction, 0).astype(np.int8)
                return signs, np.asarray(np.where(known, log_size + np.log(scale), -np.inf))
        raise AccuracyError(
            f"the derivatives with respect to resistances may be off by {np.exp(min(doubt - largest, 0.0)):.0e} of the "
            "largest of them: the conductances span too many decades"
        )

    def _quickly(self, factors: Factor, rhs: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
        """Signs and logarithms of the differences of ``lambda``, and of what they may be off by at most."""
        system = factors.system
        try:
            x = factors.solve(rhs, rtol=_RTOL)
        except AccuracyError as error:
            x = np.asarray(error.best, dtype=np.float64)
        coupled = system.degree * np.abs(x) + system.coupling @ np.abs(x) + np.abs(rhs)
        residual = np.abs(rhs - (system.degree * x - system.coupling @ x)) + 4.0 * _EPS * coupled
        return *self._across([Scaled.of(x)]), self._log_doubt(residual)

    def _by_entry(self, factors: Factor, rhs: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
        """As `_quickly`, from solutions for currents of one sign."""
        parts, residual = [], np.zeros(len(rhs))
        bound = 0.0
        for part in (np.maximum(rhs, 0.0), np.maximum(-rhs, 0.0)):
            watch = Watch()
            x, error = factors.solve_nonnegative(part, watch=watch) if part.any() else (Scaled.of(part), 0.0)
            parts.append(x)
            residual += error * (factors.system.degree * x.plain + factors.system.coupling @ x.plain + part)
            bound = max(bound, watch.bound)
        log_sum = np.append(np.logaddexp.reduce([x.log for x in parts]), -np.inf)
        log_sum = np.logaddexp(*log_sum[self._row.T])
        log_doubt = self._log_doubt(residual)
        if np.isfinite(bound):
            log_doubt = np.minimum(log_doubt, np.log(bound + _EPS) + log_sum)
        return *self._across(parts), log_doubt

    @cached_property
    def _row(self) -> NDArray[np.int32]:
        """Rows of the ends of every resistor, -1 where the voltage is known."""
        return cast(Factor, self.factors).system.unknown[self.ends]

    def _log_doubt(self, residual: NDArray[np.float64]) -> NDArray[np.float64]:
        """Logarithm of the error across every resistor that a residual may leave."""
        with np.errstate(divide="ignore"):
            energy = np.log(np.sum(self.height * residual**2))
        return np.asarray(0.5 * (energy - np.log(self.conductance)))

    def _across(self, parts: list[Scaled]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Sign and logarithm of the differences across resistors, of the first part less the second."""
        hi, lo, e = (
            np.stack([np.append(getattr(x, name), 0)[self._row] for x in parts]) for name in ("hi", "lo", "exponent")
        )
        top = np.where(hi != 0.0, e, np.iinfo(np.int64).min).max(axis=(0, 2))
        shift = power(np.where(hi != 0.0, e, top[:, np.newaxis]) - top[:, np.newaxis])
        high, low = (list(np.subtract(*np.moveaxis(value * shift, 2, 0))) for value in (hi, lo))
        difference = _less(high) + _less(low)
        return np.sign(difference), logarithm(np.abs(difference), np.where(difference != 0.0, top, 0))


def _less(parts: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """The first part less the second, if there is one."""
    return parts[0] if len(parts) == 1 else parts[0] - parts[1]


def adjoint_of(op: OperatingPoint, factors: Factor | None = None) -> Adjoint:
    """Make a circuit ready for derivatives; ``factors`` are those of its small signals, if they are known."""
    signals = small_signal(op)
    if factors is None:
        system = assemble(signals)
        factors = factor_system(system, "auto") if system.size else None
    height = np.zeros(0)
    if factors is not None:
        height = np.abs(factors.solve(np.ones(factors.system.size)))
        height += 1e-6 * height.max()  # what it may be off by
    return Adjoint(
        factors=factors,
        ends=ends_of(op.netlist),
        conductance=signals.conductance,
        log_amps=np.concatenate([op.resistor_log_current, op.nonlinear_log_amps]),
        direction=np.concatenate([op.resistor_direction, op.nonlinear_direction]),
        height=height,
    )
