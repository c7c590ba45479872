"""Read an operating point off a normwise solution: plain differences of plain numbers.

Voltages are spread over the nodes at once; currents and what is summed up from them wait until they are asked for.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.equations import Equations
from resgrid.circuit.operating_point import Ammeters, OperatingPoint, Readings
from resgrid.circuit.readout import injected_currents
from resgrid.circuit.sources import SourceForest, source_currents
from resgrid.netlist import Netlist


def read_plain(system: Equations, x: NDArray[np.float64], method: str, seconds: Mapping[str, float]) -> OperatingPoint:
    """Spread a solution over the nodes.  Shapes: `x` (n,)."""
    forest = system.forest
    height = _heights(system, x)
    unsolved = np.concatenate([forest.order, system.undriven, system.floating])
    point = OperatingPoint(
        netlist=system.netlist,
        voltage=height if system.reference == 0.0 else system.reference + height,
        log_drop=None,
        potential=_potential(system, height, x),
        ammeters=Ammeters(partial(_readings, system.netlist, forest, height, unsolved)),
        floating=system.floating,
        undriven=system.undriven,
        method=method,
        seconds=seconds,
    )
    if forest.loop.any():
        _ = point.readings  # warns of currents that are undetermined
    return point


def _heights(system: Equations, x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Voltages of all nodes above the reference."""
    from resgrid.circuit.assembly_kernels import spread

    height = system.known_voltages()
    spread(system.unknown, x, system.reference, height)
    forest = system.forest
    lifted = (system.unknown[forest.order] >= 0) & (forest.height != 0)
    height[forest.order[lifted]] += forest.height[lifted]
    return height


def _potential(system: Equations, height: NDArray[np.float64], x: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Between two rails the share of their difference; above a single one the share of the highest node."""
    if system.rails is not None:
        return _share(height, system.reference - system.rails.low, system.rails.high - system.rails.low)
    if system.feed.any() or not x.size:
        return None
    if np.all(system.injected >= 0):
        top = float(x.max())
    elif np.all(system.injected <= 0):
        top = float(x.min())
    else:
        return None
    return _share(height, 0.0, top) if top else None


def _share(height: NDArray[np.float64], shift: float, span: float) -> NDArray[np.float64]:
    """``(height + shift) / span``, the same array where that changes nothing."""
    if shift != 0.0:
        height = height + shift
    return height if span == 1.0 else height / span


def _readings(
    netlist: Netlist, forest: SourceForest, height: NDArray[np.float64], unsolved: NDArray[np.int64]
) -> Readings:
    """Difference the heights of all nodes, and sum up the currents; ``unsolved`` nodes need no balance."""
    from resgrid.circuit.assembly_kernels import plain_currents

    injected = injected_currents(netlist)
    outflow, through = -injected, np.abs(injected)
    amps = np.empty(len(netlist.conductance))
    power = plain_currents(netlist.resistor_nodes, netlist.conductance, height, amps, outflow, through)
    source_current = source_currents(netlist, forest, outflow)
    through[unsolved] = 0.0
    carries = through > 0
    residual = np.abs(outflow[carries]) / (0.5 * through[carries])
    return Readings(
        resistor_current=amps,
        resistor_direction=np.sign(amps).astype(np.int8),
        source_current=source_current,
        power=power,
        kcl_residual=float(residual.max(initial=0.0)),
    )
