"""The operating point of a circuit: node voltages, branch currents, power and the KCL residual."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.values import frozen, lock, picture_html
from resgrid.core.netlist import Netlist
from resgrid.errors import InputError
from resgrid.solvers.scaled import Numbers, logarithm

_DIRECT_CURRENT = (
    "node_count", "resistor_nodes", "conductance", "source_nodes", "source_volts", "current_nodes", "current_amps",
    "nonlinear_nodes", "nonlinear_current", "nonlinear_voltage",
)  # fmt: skip
"""Names of the fields of a netlist that determine the operating point."""

OUT_OF_RANGE = (
    "a voltage exceeds 1.8e308 V, the range of double precision: the injected currents are too large for the "
    "conductances that carry them; check their units"
)


class BranchCurrents(NamedTuple):
    """Currents of resistors and voltage sources, the dissipated power and the KCL residual.

    `resistor_current` (resistors,): currents in amperes, from the first node to the second, 0 if they underflow;
    `scaled`: the resistor currents as mantissas and exponents, ``mantissa * 2**(256 exponent)`` A, (resistors,) each;
    `source_current` (sources,): currents in amperes, into the plus terminal; `power`: dissipated power in watts;
    `kcl_residual`: largest violation of Kirchhoff's current law, as a fraction of the current through the node (half
    the sum of the magnitudes of its currents).
    """

    resistor_current: NDArray[np.float64]
    scaled: Numbers
    source_current: NDArray[np.float64]
    power: float
    kcl_residual: float


@frozen
@dataclass(frozen=True, eq=False)
class OperatingPoint:
    """The direct-current solution of a netlist.

    Branch currents of a normwise solution are computed from the voltages at the first access.

    Attributes
    ----------
    netlist : Netlist
        The circuit.
    voltage : ndarray of float64, shape (nodes,)
        Node voltages above ground, in volts; NaN where a node floats.
    log_drop : ndarray of float64, shape (nodes,), or None
        Natural logarithm of the drop ``u = (V_high - V) / (V_high - V_low)`` from the high rail (of a compiled space:
        the obstacle rail).  Its accuracy is ``entry_error``, even where ``u`` itself underflows.  It is 0 on the low
        rail, -inf on the high rail and at nodes without current, and NaN at nodes that sources hold at other voltages.
        None unless exactly two known voltages, the rails, drive the circuit.
    potential : ndarray of float64, shape (nodes,), or None
        With two rails ``1 - u``, computed from ``u`` or from ``1 - u``, whichever is smaller.  With one rail and
        current sources of one sign, the voltage above (or below) that rail, scaled to a maximum of 1.  Otherwise None.
    floating : ndarray of int64
        Nodes without a path of resistors or voltage sources to ground.  The voltages of these nodes are NaN; currents
        between them are known, since the source currents into each floating component add up to zero.
    undriven : ndarray of int64
        Nodes of components that touch a single known voltage and have no current source: all are at that voltage.
    method : str
        Method of the linear solves: ``"direct"``, ``"multigrid"``, or ``"none"`` if no voltage was unknown; with
        nonlinear resistors it begins with ``"newton, "``.
    seconds : mapping of str to float
        Wall-clock time of each stage of the solve, in seconds, by the name of the stage.
    threads : int
        Number of threads that the solve used: 1 if several would not be faster.
    iterations : int
        Steps of the iterative method, summed over right-hand sides and refinement; 0 for the direct method.
    backward_error : float
        Backward error of the linear system: componentwise for ``accuracy = "direction"``, normwise for ``"normwise"``.
        With nonlinear resistors, the backward error belongs to the last linear system.
    entry_error : float
        Bound on the relative error of every drop ``u``, however small (with one rail: of every voltage above that
        rail), proved from the KCL residuals (`resgrid.solvers.refinement`).  The rounding of the logarithm to a double
        is not included.  In circuits without two rails of up to about 800 nodes the bound holds for voltages above
        ground as well.  The bound is infinite without a proof: for normwise solutions, for circuits with nonlinear
        resistors, for larger circuits with one rail and currents of both signs, and for circuits with components that
        carry no current.
    nonlinear_amps : ndarray of float64, shape (nonlinear resistors,)
        Current from the first node of a nonlinear resistor to the second, in amperes; 0 if it underflows.
    nonlinear_log_amps : ndarray of float64, shape (nonlinear resistors,)
        Natural logarithm of the magnitude of a nonlinear resistor's current in amperes; -inf for 0 A.
    nonlinear_direction : ndarray of int8, shape (nonlinear resistors,)
        Sign of a nonlinear resistor's current: 1 from the first node to the second, -1 back, 0 for no current.
    resistor_current : ndarray of float64, shape (resistors,)
        Current from the first node of a resistor to the second, in amperes; 0 if it underflows.
    resistor_log_current : ndarray of float64, shape (resistors,)
        Natural logarithm of the magnitude of every resistor's current in amperes; -inf for 0 A.
    resistor_direction : ndarray of int8, shape (resistors,)
        Sign of every resistor's current: 1 from the first node to the second, -1 back, or 0.
    source_current : ndarray of float64, shape (sources,)
        Current into the plus terminal of every voltage source, in amperes; NaN for sources in a loop of sources.
    power : float
        Power dissipated in the resistors, nonlinear ones included, in watts.
    kcl_residual : float
        Largest violation of Kirchhoff's current law at a node, relative to the current through that node: half the sum
        of the magnitudes of its currents.
    readings : BranchCurrents
        Branch currents, power and KCL residual.
    has_stored_currents : bool
        Whether the solve computed the branch currents.

    Examples
    --------
    >>> divider = rg.Netlist(3, [[1, 2], [2, 0]], [1e-3, 3e-3], source_nodes=[[1, 0]], source_volts=[2.0])
    >>> op = rg.solve(divider)
    >>> op.voltage.round(9), op.resistor_current.round(9), op.source_current.round(9)
    (array([0. , 2. , 0.5]), array([0.0015, 0.0015]), array([-0.0015]))
    >>> round(op.power, 9), op.kcl_residual < 1e-12
    (0.003, True)
    """

    netlist: Netlist
    voltage: NDArray[np.float64]
    log_drop: NDArray[np.float64] | None
    potential: NDArray[np.float64] | None
    _currents: BranchCurrents | Callable[[], BranchCurrents]
    floating: NDArray[np.int64]
    undriven: NDArray[np.int64]
    method: str
    seconds: Mapping[str, float]
    threads: int = 1
    iterations: int = 0
    backward_error: float = 0.0
    entry_error: float = np.inf
    nonlinear_amps: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    nonlinear_log_amps: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    nonlinear_direction: NDArray[np.int8] = field(default_factory=lambda: np.empty(0, dtype=np.int8))

    def __repr__(self) -> str:
        known = self.voltage[np.isfinite(self.voltage)]
        span = f"{known.min():.4g} to {known.max():.4g} V"
        return f"<OperatingPoint of {self.netlist!r}: {span}, {self.method}, {sum(self.seconds.values()):.3g} s>"

    _repr_html_ = picture_html

    def is_of(self, netlist: Netlist) -> bool:
        """Return whether a netlist has the same resistors and sources, and thus the same operating point.

        Parameters
        ----------
        netlist : Netlist
            The netlist to compare with.

        Returns
        -------
        bool
            True if the fields that determine the operating point are equal.

        Raises
        ------
        InputError
            If `netlist` is not a `Netlist`.
        """
        one, other = self.netlist, netlist
        if not isinstance(other, Netlist):
            raise InputError(f"netlist is of type {type(other).__name__}; give a Netlist")
        return one is other or all(np.array_equal(getattr(one, part), getattr(other, part)) for part in _DIRECT_CURRENT)

    @cached_property
    def readings(self) -> BranchCurrents:
        """Branch currents, power and KCL residual, computed at the first access of a normwise solution.

        Concurrent first accesses may compute these values twice, with equal results.
        """
        currents = self._currents if isinstance(self._currents, BranchCurrents) else self._currents()
        lock(currents)
        return currents

    @property
    def has_stored_currents(self) -> bool:
        """Whether the solve computed the branch currents; a normwise solution computes them at the first access."""
        return isinstance(self._currents, BranchCurrents)

    @property
    def resistor_current(self) -> NDArray[np.float64]:
        """Current from the first node to the second of every resistor, in amperes, (resistors,); 0 if it underflows."""
        return self.readings.resistor_current

    @property
    def resistor_log_current(self) -> NDArray[np.float64]:
        """Natural logarithm of the magnitude of every resistor's current in amperes, (resistors,); -inf for 0 A."""
        amps, exponent = self.readings.scaled
        return logarithm(np.abs(amps), exponent)

    @property
    def resistor_direction(self) -> NDArray[np.int8]:
        """Sign of every resistor's current, (resistors,): 1 from the first node to the second, -1 back, 0 for 0 A."""
        return np.sign(self.readings.scaled[0]).astype(np.int8)

    @property
    def source_current(self) -> NDArray[np.float64]:
        """Current into the plus terminal of every voltage source, in amperes, shape (sources,).

        SPICE uses the same sign convention.  NaN for sources in a loop of sources.
        """
        return self.readings.source_current

    @property
    def power(self) -> float:
        """Power dissipated in the resistors, nonlinear ones included, in watts."""
        return self.readings.power

    @property
    def kcl_residual(self) -> float:
        """Largest violation of Kirchhoff's current law at a node, relative to the current through that node.

        The current through a node is half the sum of the magnitudes of its currents.  Nodes joined by floating voltage
        sources (sources without a chain of sources to ground) count as one node.
        """
        return self.readings.kcl_residual
