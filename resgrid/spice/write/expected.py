"""What a simulator should find in a deck."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from resgrid.errors import InputError
from resgrid.nodal.operating_point import OperatingPoint
from resgrid.spice.write.flat import FlatDeck


@dataclass(frozen=True, eq=False)
class Expected:
    """Voltages and source currents that a deck should have.

    `voltage`: per node of the deck, ground excluded, in volts; `source_current`: into the plus terminal of every
    voltage source of the deck, in amperes; None where it is undetermined; `supply`: largest voltage difference in the
    circuit, in volts: what tolerances are relative to. With two rails it is the difference of the rails, by the
    maximum principle; `current_scale`: what tolerances of currents are relative to, in amperes: the largest source
    current, or a thousandth of what the largest conductance carries at the supply, if that is more; `kcl_residual`:
    what the voltages are worth: largest violation of Kirchhoff's current law, relative to the current through the
    same node.
    """

    voltage: Mapping[str, float]
    source_current: Mapping[str, float | None]
    supply: float
    current_scale: float
    kcl_residual: float


def expect(deck: FlatDeck, point: OperatingPoint) -> Expected:
    """Tie an operating point to the names of a deck of the same netlist."""
    if not point.is_of(deck.netlist):
        raise InputError("the operating point belongs to another netlist; solve this one first")
    voltage = point.voltage[deck.nodes]
    if not np.isfinite(voltage).all():
        name = deck.node_names[int(np.flatnonzero(~np.isfinite(voltage))[0])]
        raise InputError(f"the operating point has no voltage for node {name}; solve this netlist first")
    supply = supply_of(point)
    current = point.source_current[deck.sources]
    return Expected(
        voltage=dict(zip(deck.node_names, voltage.tolist(), strict=True)),
        source_current={
            name: value if np.isfinite(value) else None
            for name, value in zip(deck.source_names, current.tolist(), strict=True)
        },
        supply=supply,
        current_scale=current_scale_of(point, supply),
        kcl_residual=point.kcl_residual if np.isfinite(point.kcl_residual) else 0.0,
    )


def supply_of(point: OperatingPoint) -> float:
    """Largest voltage difference in a circuit, in volts; 1 where there is none."""
    netlist = point.netlist
    ends = netlist.resistor_nodes if netlist.resistor_nodes.size else netlist.source_nodes
    voltage = point.voltage[ends]
    voltage = voltage[np.isfinite(voltage)]
    span = float(np.ptp(voltage)) if voltage.size else 0.0
    return span or float(np.max(np.abs(voltage), initial=0.0)) or 1.0


def current_scale_of(point: OperatingPoint, supply: float) -> float:
    """What currents are held to, in amperes: those that are drawn, where rounding lets a simulator find them.

    Beside a conductance much larger than what the circuit draws, rounding leaves some 1e-13 of what it would carry at
    the supply (measured with ngspice 39 and 46); the tolerance of 1e-9 stays ten times above that.
    """
    drawn = point.source_current[np.isfinite(point.source_current)]
    largest = float(np.max(np.abs(drawn), initial=0.0))
    return max(largest, 1e-3 * supply * float(np.max(point.netlist.conductance, initial=0.0))) or 1.0
