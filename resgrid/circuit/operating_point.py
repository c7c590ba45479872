"""The operating point: what the chip's voltmeters and ammeters would read."""

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
"""Parts of a netlist that direct currents depend on."""


class BranchCurrents(NamedTuple):
    """What the ammeters read, and whether it adds up.

    `resistor_current, source_current, power, kcl_residual`: as the attributes of `OperatingPoint`; `scaled`: mantissas
    and exponents of the resistors' currents, in factors of 2**256: some may underflow.
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

    The currents of a normwise answer are computed from its voltages when first asked for.

    Attributes
    ----------
    netlist : Netlist
        The circuit.
    voltage : ndarray of float64, shape (nodes,)
        Node voltages above ground, in volts; NaN where a node floats.
    log_drop : ndarray of float64, shape (nodes,), or None
        Natural logarithm of the drop ``u = (V_high - V) / (V_high - V_low)`` from the high rail (the obstacle rail
        where there is a map of cells), right to ``entry_error`` even where ``u`` itself underflows; 0 on the low rail,
        -inf on the high one and wherever nothing arrives; NaN on nodes held at any other voltage, which no resistor
        touches.  None unless the circuit hangs between exactly two rails.
    potential : ndarray of float64, shape (nodes,), or None
        With two rails ``1 - u``, taken from whichever of both is smaller.  With one rail and currents of one sign the
        height above (or below) that rail, scaled to a maximum of 1.  None otherwise.
    ammeters : BranchCurrents, or callable
        Currents, power and KCL residual, at hand or to be read: the point has each reading as a property.
    floating : ndarray of int64
        Nodes that no path of resistors or voltage sources ties to ground; their voltages are NaN, currents known.
        The currents of current sources into each floating part add up to zero.
    undriven : ndarray of int64
        Nodes of parts that a single rail holds and no current drives: they are flat, at that rail's voltage.
    method : str
        How it was solved: ``"direct"``, ``"multigrid"``, or ``"none"`` where the rails hold every node; after
        ``"newton, "`` with nonlinear resistors.
    seconds : mapping of str to float
        Wall-clock time of each stage.
    threads : int
        Number of threads that the solve used: 1 if several would not be faster.
    iterations : int
        Steps of the iterative method, all right-hand sides and passes of refinement together; 0 for the direct method.
    backward_error : float
        Of the solution: componentwise for ``accuracy = "direction"``, normwise for ``"normwise"``.  Of a circuit with
        nonlinear resistors it is the last linear system's.
    entry_error : float
        No drop ``u``, be it the smallest, is off by a larger share of itself (with one rail: no height above it), as
        the violations of KCL prove (`resgrid.solvers.refinement`); the rounding of its logarithm to a double is not
        counted.  Of small circuits without two rails it holds for voltages above ground as well.  Infinite where
        nothing is proved: of normwise answers, of circuits with nonlinear resistors, of larger circuits with
        currents of both signs beside a single rail, and of those where parts carry no current.
    nonlinear_amps : ndarray of float64, shape (nonlinear resistors,)
        Current from a nonlinear resistor's first node to its second, in amperes (0 where it underflows).
    nonlinear_log_amps : ndarray of float64, shape (nonlinear resistors,)
        Natural logarithm of its magnitude; -inf where no current flows.
    nonlinear_direction : ndarray of int8, shape (nonlinear resistors,)
        Its sign, as that of the resistors.

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
    ammeters: BranchCurrents | Callable[[], BranchCurrents]
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
        """Whether a netlist has the same resistors and sources, so that this is its operating point too."""
        one, other = self.netlist, netlist
        if not isinstance(other, Netlist):
            raise InputError(f"netlist is of type {type(other).__name__}; give a Netlist")
        return one is other or all(np.array_equal(getattr(one, part), getattr(other, part)) for part in _DIRECT_CURRENT)

    @cached_property
    def readings(self) -> BranchCurrents:
        """What the ammeters read; two threads that ask at once may both take it, and find the same."""
        taken = self.ammeters if isinstance(self.ammeters, BranchCurrents) else self.ammeters()
        lock(taken)
        return taken

    @property
    def resistor_current(self) -> NDArray[np.float64]:
        """Current from a resistor's first node to its second, in amperes, shape (resistors,); 0 where it underflows."""
        return self.readings.resistor_current

    @property
    def resistor_log_current(self) -> NDArray[np.float64]:
        """Natural logarithm of its magnitude, shape (resistors,); -inf where no current flows."""
        amps, exponent = self.readings.scaled
        return logarithm(np.abs(amps), exponent)

    @property
    def resistor_direction(self) -> NDArray[np.int8]:
        """Its sign, shape (resistors,): 1 from the first node to the second, -1 back, 0 none."""
        return np.sign(self.readings.scaled[0]).astype(np.int8)

    @property
    def source_current(self) -> NDArray[np.float64]:
        """Current into the plus terminal of every voltage source, in amperes, shape (sources,).

        The sign is SPICE's; NaN in a loop of sources.
        """
        return self.readings.source_current

    @property
    def power(self) -> float:
        """Power dissipated in the resistors, nonlinear ones included, in watts."""
        return self.readings.power

    @property
    def kcl_residual(self) -> float:
        """Largest violation of Kirchhoff's current law at a node, relative to the current through that same node.

        Nodes that floating voltage sources join count as one.
        """
        return self.readings.kcl_residual
