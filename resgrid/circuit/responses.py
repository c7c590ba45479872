"""Responses of a circuit to injected currents while its independent sources are zero: columns of its Green's function.

The response ``x = G^-1 c`` to currents ``c`` into the nodes is the voltage of every node while voltage sources are
wires and current sources are open.  By symmetry it is also the adjoint of the functional ``c . V`` of the node voltages
``V`` (Director & Rohrer 1969).  Positive and negative currents are solved separately, each with a small relative error
of every entry.  Numbers have separate exponents, so that currents and responses may span more than the range of
doubles.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.cancellation import with_tiny_values
from resgrid.circuit.current_recovery import recover_currents
from resgrid.circuit.equations import ALWAYS_RECOVERED, Equations, assemble
from resgrid.circuit.extreme_values import is_extreme, is_small, respond_extreme
from resgrid.circuit.postprocess import (
    DIRECTION_RESIDUAL,
    NodeValues,
    differences,
    node_sums,
    rows_to_nodes,
)
from resgrid.circuit.sources import SourceForest, source_currents, tie_sources
from resgrid.core.netlist import GROUND, Netlist
from resgrid.errors import AccuracyError
from resgrid.solvers.factors import EXACT_ROWS, Factor
from resgrid.solvers.laplacian import conductance_statistics
from resgrid.solvers.method_choice import factor_laplacian
from resgrid.solvers.progress import ProgressMonitor
from resgrid.solvers.refinement import CERTAIN, corrected, is_answer, minus, quotient
from resgrid.solvers.scaled import BITS, Numbers, Scaled, canonical, power, unscaled
from resgrid.solvers.threads import SINGLE_THREAD

_WIDE = 126
"""Binary logarithm of the ratio of two injected currents above which responses are computed in decimal arithmetic."""

_PLAIN = 1
"""Largest difference of the exponents of ``2**256`` of injected currents for a recovery of the response in doubles.

The recovery computes voltages and currents again without cancellation.
"""

_NO_EXPONENT = -(2**62)


@dataclass(frozen=True, eq=False)
class Response:
    """Voltages and currents that injected currents cause in a circuit without independent sources.

    `voltage` (nodes,): voltages in volts, 0 where the node floats; `fall` (current sources,): voltages across the
    current sources of the given circuit, first minus second node, in volts; `resistor` (resistors,): currents from the
    first to the second node in amperes; `source` (sources,): currents into the plus terminals of the voltage sources in
    amperes, NaN in loops of sources; `fall`, `resistor` and `source` are mantissas and exponents of ``2**256``.
    """

    voltage: Scaled
    fall: Numbers
    resistor: Numbers
    source: Numbers


@dataclass(frozen=True, eq=False)
class SourceFreeCircuit:
    """A circuit with voltage sources as wires and without current sources, and the factors of its matrix.

    `netlist`: the circuit, with linear resistors and voltage sources of 0 V; `forest`: spanning forest of its voltage
    sources; `pairs` (current sources, 2): nodes of the current sources of the given circuit; `system`: equations of the
    components that may be driven, None without rows; `factors`: factors of their matrix, None without rows, and for
    conductances outside the usual range, which are eliminated in decimal arithmetic.
    """

    netlist: Netlist
    forest: SourceForest
    pairs: NDArray[np.int32]
    system: Equations | None
    factors: Factor | None

    @classmethod
    def of(cls, netlist: Netlist, driven: NDArray[np.int64], method: str) -> SourceFreeCircuit:
        """Return the factored circuit, in which currents may enter the nodes `driven`.

        `netlist`: circuit with linear resistors; the values of its sources are ignored; `driven` (k,): nodes, none of
        which floats; `method`: ``"auto"``, ``"direct"`` or ``"multigrid"``.
        """
        pairs = netlist.current_nodes
        netlist = netlist.replace(
            source_volts=np.zeros(len(netlist.source_volts)),
            current_nodes=np.stack([np.full(len(driven), GROUND), driven], axis=1),
            current_amps=np.ones(len(driven)),
            element_names=None,
        )
        forest = tie_sources(netlist)
        held = np.zeros(netlist.node_count, dtype=np.bool_)
        held[forest.order[forest.base == GROUND]] = True
        quiet = netlist.replace(current_nodes=netlist.current_nodes[:0], current_amps=netlist.current_amps[:0])
        if held[driven].all():
            return cls(quiet, forest, pairs, None, None)
        with np.errstate(all="ignore"):  # extreme values may overflow
            system = assemble(netlist)
        factors = None if is_extreme(netlist) else factor_laplacian(system.laplacian, method)
        return cls(quiet, forest, pairs, system, factors)

    def respond(self, amps: Numbers) -> Response:
        """Return the voltages and currents that injected currents cause.

        `amps` (nodes,): currents into the nodes in amperes, as mantissas and exponents of ``2**256``; they return
        through ground.  Raise AccuracyError if the conductances span more orders of magnitude than the factors can
        represent, or if the responses to positive and negative currents nearly cancel.
        """
        if self.system is None:
            still = (np.zeros(count := len(self.netlist.conductance)), np.zeros(count, dtype=np.int64))
            return self._response(Scaled.of(np.zeros(self.netlist.node_count)), still, amps)
        if self.factors is None or (is_small(self.netlist) and _spans_far(amps)):
            return self._extreme(self.system, amps)
        rows, error = self._solved(self.factors, self.system, amps)
        voltage = rows_to_nodes(self.system, rows, Scaled.of(np.zeros(self.netlist.node_count)))._replace(
            noise=rows.noise
        )
        is_drop = np.zeros(self.netlist.node_count, dtype=np.bool_)
        values = NodeValues(voltage, is_drop, 0.0, 1.0, rows.noise)
        current, exponent, _, _ = differences(values, self.netlist, SINGLE_THREAD)
        response = self._response(voltage, (current, exponent), amps)
        if self._may_cancel(self.system, error):
            recovered = self._recovered(self.system, response, amps)
            response, error = (response, error) if recovered is None else (recovered, 0.0)
        if error > DIRECTION_RESIDUAL:
            raise AccuracyError(
                f"the response to currents of both signs nearly cancels: its error may be {error:.1e} of the "
                f"largest voltage (at most {DIRECTION_RESIDUAL:g} is allowed); differentiate single voltages"
            )
        return response

    def _extreme(self, system: Equations, amps: Numbers) -> Response:
        """Return the response to injected currents `amps` (nodes,), computed in decimal arithmetic and integers.

        `system`: equations.  Raise AccuracyError if the currents span more orders of magnitude than doubles.
        """
        plain, unit = _in_doubles(amps)
        size = np.abs(plain[amps[0] != 0.0])
        if not np.all((size >= np.finfo(np.float64).tiny) & np.isfinite(size)):
            raise AccuracyError(
                "the injected currents span more orders of magnitude than doubles; differentiate fewer places"
            )
        found = respond_extreme(_driven_by(system, plain), self.pairs.tolist())
        volts, fall, resistor, source = ((mantissa, exponent + unit) for mantissa, exponent in found)
        return Response(Scaled(volts[0], np.zeros_like(volts[0]), volts[1]), fall, resistor, source)

    def _response(self, voltage: Scaled, resistor: Numbers, amps: Numbers) -> Response:
        """Return a response, with the remaining fields computed from node voltages and resistor currents.

        The remaining fields are the currents of the voltage sources, which act as wires, and the voltages across the
        current sources of the given circuit (first minus second node).  `voltage` (nodes,): in volts; `resistor`
        (resistors,): currents in amperes from the first to the second node; `amps` (nodes,): currents injected into the
        nodes, in amperes.  Currents are mantissas and exponents of ``2**256``.
        """
        first, second = (Scaled(*(part[end] for part in voltage[:3])) for end in self.pairs.T)
        fall = minus(first, second)
        return Response(voltage, (fall.hi, fall.exponent), resistor, self._source_currents(resistor, amps))

    def _recovered(self, system: Equations, first: Response, amps: Numbers) -> Response | None:
        """Return a response in which no digits are lost where large values cancel, or None if it is not possible.

        `system`: equations; `first`: response before the recovery; `amps` (nodes,): currents injected into the nodes,
        in amperes, as mantissas and exponents of ``2**256``.
        """
        plain, unit = _in_doubles(amps)
        if np.any((amps[0] != 0.0) & (np.abs(amps[1] - unit) > _PLAIN)):
            return None
        found, _ = recover_currents(_driven_by(system, plain), self.pairs.tolist())
        if found is None or found.error_bound > DIRECTION_RESIDUAL:
            return None

        def with_unit(values: NDArray[np.float64], before: Numbers) -> Numbers:
            """Return recovered values as mantissas and exponents of ``2**256``.

            `values`: recovered values in units of ``2**(256 unit)``; `before`: values before the recovery, which
            replace those that the recovery has set to zero because they are too small.
            """
            mantissa, exponent = with_tiny_values(values, found.floor, before[0], before[1] - unit)
            return mantissa, exponent + unit

        resistor = with_unit(found.amps, first.resistor)
        if found.falls is None:
            return self._response(first.voltage, resistor, amps)
        volts, exponent = with_unit(np.nan_to_num(found.volts), (first.voltage.hi, first.voltage.exponent))
        voltage = Scaled(volts, np.zeros_like(volts), exponent, first.voltage.noise)
        return Response(
            voltage, with_unit(found.falls, first.fall), resistor, with_unit(found.source_amps, first.source)
        )

    def _solved(self, factors: Factor, system: Equations, amps: Numbers) -> tuple[Scaled, float]:
        """Return the voltages (n,) of the rows in volts, and a bound on their error relative to the largest one.

        `factors`, `system`: factors and equations; `amps` (nodes,): currents into the nodes in amperes, as mantissas
        and exponents of ``2**256``.
        """
        parts, bound = [], 0.0
        for sign in (1.0, -1.0):
            rhs = _sum_by_row(system, np.maximum(sign * amps[0], 0.0), amps[1])
            if not rhs.hi.any():
                parts.append(rhs)
                continue
            watch = ProgressMonitor()
            x, error = factors.solve_nonnegative(rhs, watch=watch)
            if not is_answer(error, watch.bound):
                raise AccuracyError(
                    f"method {factors.name!r} reached a componentwise backward error of only {error:.1e}: the "
                    "conductances span more orders of magnitude than it can represent; use another method"
                )
            parts.append(x)
            bound = max(bound, watch.bound)
        if not parts[1].hi.any():
            return parts[0], 0.0
        if not parts[0].hi.any():
            return Scaled(-parts[1].hi, -parts[1].lo, *parts[1][2:]), 0.0
        x, noise = minus(*parts), max(part.noise for part in parts)
        return x._replace(noise=noise), min(bound, noise if system.size <= EXACT_ROWS else np.inf) * quotient(parts, x)

    def _may_cancel(self, system: Equations, error: float) -> bool:
        """Return whether voltage differences may have lost their digits and can be recovered.

        To recover them is to compute them again without cancellation.  `system`: equations; `error`: bound on the error
        of a voltage relative to the largest one.
        """
        if system.size > EXACT_ROWS:
            return error > DIRECTION_RESIDUAL
        if error > CERTAIN or (self.netlist.cell_map is None and self.netlist.node_count <= ALWAYS_RECOVERED):
            return True
        return conductance_statistics(system.laplacian).is_stiff

    def _source_currents(self, resistor: Numbers, amps: Numbers) -> Numbers:
        """Return the currents into the plus terminals of the voltage sources in amperes, (sources,).

        `resistor` (resistors,): currents from the first to the second node; `amps` (nodes,): currents into the nodes;
        arguments and result are mantissas and exponents of ``2**256``.
        """
        frame, net, through = node_sums(self.netlist, *resistor)
        total = corrected(Scaled(net, np.zeros_like(net), frame), *_returning(amps))
        mantissa, exponent = total.hi.copy(), total.exponent.copy()
        canonical(mantissa, exponent)
        ends = self.netlist.source_nodes
        tied = ends.max(axis=1, initial=0)
        single = (ends.min(axis=1) == GROUND) & (tied != GROUND)
        single &= np.bincount(ends.ravel(), minlength=self.netlist.node_count)[tied] == 1
        sign = np.where(ends[:, 0] == tied, 1.0, -1.0)
        found, scale = sign * mantissa[tied], np.where(single, exponent[tied], 0)
        if not single.all():
            unit = self._exponents_of_trees(exponent, mantissa != 0.0, frame, through != 0.0)
            scale[~single] = unit[tied[~single]]
            own = mantissa * power(exponent - unit)
            largest = np.maximum(np.abs(own), through * power(frame - unit))
            found[~single] = source_currents(self.netlist, self.forest, -own, largest)[~single]
        return found, scale

    def _exponents_of_trees(
        self, net: NDArray[np.int64], flows: NDArray[np.bool_], through: NDArray[np.int64], passes: NDArray[np.bool_]
    ) -> NDArray[np.int64]:
        """Return the largest exponent of ``2**256`` of the currents in the tree of sources of every node, (nodes,).

        `net`, `through` (nodes,): exponents of net and of through-currents; `flows`, `passes` (nodes,): whether the net
        and the through-current are not 0.  The result is 0 without any current.
        """
        base, unit = np.arange(len(net)), np.full(len(net), _NO_EXPONENT)
        base[self.forest.order] = self.forest.base
        for exponent, present in ((net, flows), (through, passes)):
            np.maximum.at(unit, base[present], exponent[present])
        return np.asarray(np.where(unit == _NO_EXPONENT, 0, unit)[base])


def _in_doubles(amps: Numbers) -> tuple[NDArray[np.float64], int]:
    """Return currents as doubles in units of ``2**(256 unit)`` A, and the unit, in the middle of their range.

    `amps` (nodes,): mantissas and exponents of ``2**256``.  Currents far from the middle may underflow or overflow.
    """
    digits = _digits(amps)
    unit = round(0.5 * int(digits.max() + digits.min()) / BITS) if digits.size else 0
    return unscaled(amps[0], amps[1] - unit), unit


def _digits(amps: Numbers) -> NDArray[np.int64]:
    """Return the binary logarithms, rounded up, of the currents other than 0, in amperes.

    `amps` (nodes,): mantissas and exponents of ``2**256``.
    """
    used = amps[0] != 0.0
    return np.asarray(np.frexp(amps[0][used])[1] + BITS * amps[1][used])


def _spans_far(amps: Numbers) -> bool:
    """Return whether the ratio of two injected currents exceeds ``2**126``.

    `amps` (nodes,): mantissas and exponents of ``2**256``; currents of 0 do not count.
    """
    digits = _digits(amps)
    return bool(digits.size) and int(digits.max() - digits.min()) > _WIDE


def _returning(amps: Numbers) -> Numbers:
    """Return the currents into the nodes in amperes, (nodes,), with the returning current of ground.

    The entry of ground is the negative sum of the other entries.  `amps` (nodes,): currents into the nodes; argument
    and result are mantissas and exponents of ``2**256``.
    """
    mantissa, exponent = amps[0].copy(), amps[1].copy()
    mantissa[GROUND] = 0.0
    unit = int(exponent[mantissa != 0.0].max(initial=_NO_EXPONENT))
    if unit > _NO_EXPONENT:
        mantissa[GROUND], exponent[GROUND] = -math.fsum((mantissa * power(exponent - unit)).tolist()), unit
    return mantissa, exponent


def _driven_by(system: Equations, amps: NDArray[np.float64]) -> Equations:
    """Return the equations with other values of the current sources.

    `amps` (nodes,): current in amperes of the only source into each node, from ground; 0 for nodes without a source.
    """
    row, netlist = system.unknown, system.netlist
    injected = np.bincount(row[row >= 0], amps[row >= 0], system.size).astype(np.float64)
    return replace(system, netlist=netlist.replace(current_amps=amps[netlist.current_nodes[:, 1]]), injected=injected)


def _sum_by_row(system: Equations, mantissa: NDArray[np.float64], exponent: NDArray[np.int64]) -> Scaled:
    """Return the sum of the currents into every row in amperes, (n,).

    `mantissa`, `exponent` (nodes,): nonnegative currents ``mantissa * 2**(256 exponent)`` A into the nodes.
    """
    node = np.flatnonzero((mantissa > 0.0) & (system.unknown >= 0))
    row, frame = system.unknown[node], np.full(system.size, _NO_EXPONENT)
    np.maximum.at(frame, row, exponent[node])
    total = np.bincount(row, mantissa[node] * power(exponent[node] - frame[row]), system.size).astype(np.float64)
    return Scaled(total, np.zeros(system.size), np.where(frame == _NO_EXPONENT, 0, frame))
