"""What a simulator should find in a deck."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from resgrid.errors import InputError
from resgrid.nodal.operating_point import OperatingPoint
from resgrid.spice.write.flat import Deck


@dataclass(frozen=True, eq=False)
class Expected:
    """Voltages and source currents that a deck should have.

    `voltage`: per node of the deck, ground excluded, in volts; `source_current`: into the plus terminal of every
    voltage source of the deck, in amperes; None where it is undetermined; `supply`: largest voltage difference in the
    circuit, in volts: what tolerances are relative to; with two rails it is the difference of the rails, by the
    maximum principle; `current_scale`: what tolerances of currents are relative to, in amperes; `kcl_residual`: what
    the voltages are worth: largest violation of Kirchhoff's current law, relative to the current through the same
    node.
    """

    voltage: Mapping[str, float]
    source_current: Mapping[str, float | None]
    supply: float
    current_scale: float
    kcl_residual: float

    @staticmethod
    def of(op: OperatingPoint, voltage: Mapping[str, float], source_current: Mapping[str, float]) -> Expected:
        """What an operating point says of these voltages and currents."""
        supply = _supply_of(op)
        return Expected(
            voltage=voltage,
            source_current={name: amps if np.isfinite(amps) else None for name, amps in source_current.items()},
            supply=supply,
            current_scale=_current_scale_of(op, supply),
            kcl_residual=op.kcl_residual if np.isfinite(op.kcl_residual) else 0.0,
        )


def expect(deck: Deck, op: OperatingPoint) -> Expected:
    """Tie an operating point to the names of a deck of the same netlist."""
    if not op.is_of(deck.netlist):
        raise InputError("the operating point belongs to another netlist; solve this one first")
    voltage = op.voltage[deck.nodes]
    if not np.isfinite(voltage).all():
        name = deck.node_names[int(np.flatnonzero(~np.isfinite(voltage))[0])]
        raise InputError(f"the operating point has no voltage for node {name}; solve this netlist first")
    current = op.source_current[deck.sources].tolist()
    return Expected.of(
        op,
        dict(zip(deck.node_names, voltage.tolist(), strict=True)),
        dict(zip(deck.source_names, current, strict=True)),
    )


def _supply_of(op: OperatingPoint) -> float:
    """Largest voltage difference in a circuit, in volts; 1 where there is none."""
    netlist = op.netlist
    ends = netlist.resistor_nodes if netlist.resistor_nodes.size else netlist.source_nodes
    voltage = op.voltage[ends]
    voltage = voltage[np.isfinite(voltage)]
    span = float(np.ptp(voltage)) if voltage.size else 0.0
    return span or float(np.max(np.abs(voltage), initial=0.0)) or 1.0


def _current_scale_of(op: OperatingPoint, supply: float) -> float:
    """What currents are held to, in amperes: those that are drawn, where rounding lets a simulator find them.

    Beside a conductance much larger than what the circuit draws, rounding leaves some 1e-13 of what it would carry at
    the supply (measured with ngspice 39 and 46); the tolerance of 1e-9 stays ten times above that.
    """
    drawn = op.source_current[np.isfinite(op.source_current)]
    largest = float(np.max(np.abs(drawn), initial=0.0))
    return max(largest, 1e-3 * supply * float(np.max(op.netlist.conductance, initial=0.0))) or 1.0
