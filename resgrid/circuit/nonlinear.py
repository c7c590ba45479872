"""The operating point of a circuit with nonlinear resistors, read off the linear circuit of their secants."""

from __future__ import annotations

import dataclasses
import time

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.equations import assemble
from resgrid.circuit.linear import solve_linear
from resgrid.circuit.newton import differential_conductance, linear_netlist, newton, secant_conductance
from resgrid.circuit.operating_point import OperatingPoint
from resgrid.circuit.readout import DIRECTION_RESIDUAL
from resgrid.circuit.saturation import refuse_saturated_cut
from resgrid.errors import AccuracyError
from resgrid.netlist import Netlist
from resgrid.solvers.monitor import Progress

_SHARE_NOISE = 1e-13
"""Relative error of nonlinear currents; near saturation it makes much of the drop uncertain."""

_SETTLED = 1e-13
_MOST_PASSES = 8


def solve_nonlinear(
    netlist: Netlist, *, accuracy: str, method: str, rtol: float, progress: Progress | None = None
) -> OperatingPoint:
    """Find the operating point of a netlist with nonlinear resistors; the rest of `resgrid.solve`.

    Newton's method gives voltages to the rounding of doubles; the linear circuit of the secant conductances at them
    gives the answer with its last digits, and better secants, until these rest.
    """
    try:
        return _settled(netlist, accuracy=accuracy, method=method, rtol=rtol, progress=progress)
    except AccuracyError:
        # Voltages without bound look like any other failure until the flow through the circuit is asked.
        refuse_saturated_cut(netlist, assemble(linear_netlist(netlist, netlist.nonlinear_current)))
        raise


def _settled(netlist: Netlist, *, accuracy: str, method: str, rtol: float, progress: Progress | None) -> OperatingPoint:
    start = time.perf_counter()
    voltage = newton(netlist, method=method).voltage
    seconds = time.perf_counter() - start
    secant = secant_conductance(netlist, _drops(netlist, voltage))
    best: OperatingPoint | None = None
    least = np.inf
    for _ in range(_MOST_PASSES):
        chords = linear_netlist(netlist, secant)
        point = solve_linear(chords, accuracy=accuracy, method=method, rtol=rtol, progress=progress)
        drop = point.resistor_current[len(netlist.conductance) :] / secant
        better = secant_conductance(netlist, drop)
        change = float(np.abs(better / secant - 1).max())
        if not change < least:
            break
        best, least, secant = point, change, better
        if change <= _SETTLED:
            break
    assert best is not None
    answer = _in_place(netlist, best, least, seconds)
    if least > DIRECTION_RESIDUAL:
        raise AccuracyError(
            f"the currents of nonlinear resistors are settled to {least:.1e} only: V0 is too small beside the "
            "voltages of the circuit to tell the drop across a resistor",
            answer,
        )
    return answer


def small_signal(op: OperatingPoint) -> Netlist:
    """The linear circuit that small signals see around an operating point.

    Parameters
    ----------
    op : OperatingPoint

    Returns
    -------
    Netlist
        The same nodes, sources and capacitors; every nonlinear resistor is a resistor of its differential conductance
        ``dI / dV``, appended to the resistors.

    Examples
    --------
    >>> netlist = rg.Netlist(
    ...     3, [[1, 2]], [1e-3], source_nodes=[[1, 0]], source_volts=[0.2],
    ...     nonlinear_nodes=[[2, 0]], nonlinear_current=[1e-3], nonlinear_voltage=[0.1],
    ... )
    >>> rg.small_signal(rg.solve(netlist)).conductance.round(6)
    array([0.001  , 0.00967])
    """
    netlist = op.netlist
    if not netlist.nonlinear_nodes.size:
        return netlist
    return linear_netlist(netlist, differential_conductance(netlist, nonlinear_drops(op)))


def nonlinear_drops(point: OperatingPoint) -> NDArray[np.float64]:
    """Voltages across the nonlinear resistors, as their currents tell them, or the node voltages where these tell more.

    Returns (nonlinear resistors,).
    """
    netlist = point.netlist
    scale, share = netlist.nonlinear_voltage, np.abs(point.nonlinear_amps) / netlist.nonlinear_current
    largest = np.abs(np.nan_to_num(point.voltage)[netlist.nonlinear_nodes]).max(axis=1, initial=0.0)
    saturated = (share > 0.5) & (_SHARE_NOISE * scale > np.finfo(np.float64).eps * largest * (1.0 - share))
    told = np.sign(point.nonlinear_amps) * scale * np.arctanh(np.where(saturated, 0.0, share))
    return np.where(saturated, _drops(netlist, point.voltage), told)


def _drops(netlist: Netlist, voltage: NDArray[np.float64]) -> NDArray[np.float64]:
    first, second = voltage[netlist.nonlinear_nodes].T
    return np.asarray(np.nan_to_num(first - second))


def _in_place(netlist: Netlist, point: OperatingPoint, change: float, seconds: float) -> OperatingPoint:
    """The operating point of the linear circuit as that of the nonlinear one."""
    m, log = len(netlist.conductance), point.resistor_log_current
    return dataclasses.replace(
        point,
        netlist=netlist,
        entry_error=np.inf,
        ammeters=point.readings.of_first(m, max(point.kcl_residual, change)),
        nonlinear_amps=point.resistor_current[m:],
        nonlinear_log_amps=log[m:],
        nonlinear_direction=point.resistor_direction[m:],
        method=f"newton, {point.method}",
        seconds={"newton": seconds, **point.seconds},
    )
