"""The operating point: what the chip's voltmeters and ammeters would read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from resgrid.netlist import Netlist


@dataclass(frozen=True, eq=False)
class OperatingPoint:
    """The direct-current solution of a netlist.

    Attributes
    ----------
    netlist : Netlist
        The circuit.
    voltage : ndarray of float64, shape (nodes,)
        Node voltages above ground, in volts; NaN where a node floats.
    log_drop : ndarray of float64, shape (nodes,), or None
        Natural logarithm of the drop ``u = (V_high - V) / (V_high - V_low)`` from the high rail (the obstacle rail
        where there is a layout), right to the last digits even where ``u`` itself underflows; 0 on the low rail,
        -inf on the high one and wherever nothing arrives.  None unless the circuit has exactly two rails.
    potential : ndarray of float64, shape (nodes,), or None
        With two rails ``1 - u``, taken from whichever of both is smaller.  With one rail and currents of one sign the
        height above (or below) that rail, scaled to a maximum of 1.  None otherwise.
    resistor_current : ndarray of float64, shape (resistors,)
        Current from a resistor's first node to its second, in amperes (0 where it underflows).
    resistor_log_current : ndarray of float64, shape (resistors,)
        Natural logarithm of its magnitude; -inf where no current flows.
    resistor_direction : ndarray of int8, shape (resistors,)
        Its sign: 1 from the first node to the second, -1 back, 0 none.
    source_current : ndarray of float64, shape (sources,)
        Current into the plus terminal of every voltage source (SPICE's sign), in amperes; NaN in a loop of sources.
    power : float
        Power dissipated in the resistors, nonlinear ones included, in watts.
    kcl_residual : float
        Largest violation of Kirchhoff's current law at a node, relative to the current through that same node.
    floating : ndarray of int64
        Nodes that no path of resistors or voltage sources ties to ground; their voltage is NaN.
    undriven : ndarray of int64
        Nodes of parts that a single rail holds and no current drives: they are flat, at that rail's voltage.
    method : str
        How it was solved: ``"direct"``, ``"multigrid"``, or ``"elimination"`` where elimination left nothing.
    seconds : mapping of str to float
        Wall-clock time of each stage.
    iterations : int
        Steps of the iterative method, all right-hand sides and passes of refinement together; 0 for the direct method
        and for elimination.
    backward_error : float
        Of the solution: componentwise for ``accuracy = "direction"``, normwise for ``"normwise"``.  Of a circuit with
        nonlinear resistors it is the last linear system's.
    nonlinear_amps : ndarray of float64, shape (nonlinear resistors,)
        Current from a nonlinear resistor's first node to its second, in amperes (0 where it underflows).
    nonlinear_log_amps : ndarray of float64, shape (nonlinear resistors,)
        Natural logarithm of its magnitude; -inf where no current flows.
    nonlinear_direction : ndarray of int8, shape (nonlinear resistors,)
        Its sign, as that of the resistors.
    """

    netlist: Netlist
    voltage: NDArray[np.float64]
    log_drop: NDArray[np.float64] | None
    potential: NDArray[np.float64] | None
    resistor_current: NDArray[np.float64]
    resistor_log_current: NDArray[np.float64]
    resistor_direction: NDArray[np.int8]
    source_current: NDArray[np.float64]
    power: float
    kcl_residual: float
    floating: NDArray[np.int64]
    undriven: NDArray[np.int64]
    method: str
    seconds: Mapping[str, float]
    iterations: int = 0
    backward_error: float = 0.0
    nonlinear_amps: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    nonlinear_log_amps: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    nonlinear_direction: NDArray[np.int8] = field(default_factory=lambda: np.empty(0, dtype=np.int8))

    def __post_init__(self) -> None:
        for name in ("voltage", "log_drop", "potential", "resistor_current", "resistor_log_current"):
            array = getattr(self, name)
            if array is not None:
                array.flags.writeable = False
        for array in (self.resistor_direction, self.source_current, self.floating, self.undriven):
            array.flags.writeable = False
        for array in (self.nonlinear_amps, self.nonlinear_log_amps, self.nonlinear_direction):
            array.flags.writeable = False
