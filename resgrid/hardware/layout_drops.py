"""Voltage drops along the rails of a layout, estimated from their sheet resistances and the currents of the circuit."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from resgrid.circuit.operating_point import OperatingPoint
from resgrid.core.regions import crossed_faces
from resgrid.hardware.layout_array import ORIGIN, TileArray
from resgrid.hardware.layout_rails import RailPlan
from resgrid.hardware.layout_rules import LayoutRules
from resgrid.hardware.layout_tiles import TileGeometry


def rail_currents(op: OperatingPoint) -> dict[str, float]:
    """Return the current of every source of an operating point in amperes, by the net at its positive terminal.

    The sign is that of `OperatingPoint.source_current`: positive into the positive terminal.
    """
    names = op.netlist.names_of(op.netlist.source_nodes[:, 0])
    return {name: float(amps) for name, amps in zip(names, op.source_current, strict=True)}


def rail_drops(
    rules: LayoutRules, array: TileArray, tile: TileGeometry, plan: RailPlan, op: OperatingPoint
) -> dict[str, float]:
    """Return the estimated largest magnitude of the voltage drop along the rail of every net, in volts, by net.

    The currents are those of ideal rails. A trunk (a vertical wire to a goal region or the start) carries the current
    of its net over its whole length. A stripe of the obstacle rail (a horizontal wire) is fed from both ends through
    vertical wires, which are fed from below; the drops of stripe and vertical wire add up. The wires from trunks and
    vertical wires to the pads are not counted.
    """
    currents = rail_currents(op)
    third = rules.metals[2]
    drops: Mapping[str, float] = {
        trunk.net: abs(currents[trunk.net]) * third.sheet * (trunk.row * tile.py - plan.tracks[number]) / trunk.width
        for number, trunk in enumerate(plan.trunks)
    }
    return dict(drops) | ({"obstacle": _obstacle_drop(rules, tile, plan, _taps(op, array))} if plan.ring else {})


def _taps(op: OperatingPoint, array: TileArray) -> NDArray[np.float64]:
    """Return the magnitude of the current between the obstacle rail and every tile, in amperes.

    It is the sum of the magnitudes of the currents of the resistors that begin or end at the rail in this tile. A tile
    is the drawing of one cell. The shape is (columns + 2, rows + 2): a margin of one tile surrounds the grid.
    """
    netlist = op.netlist
    taps, amps = np.zeros(array.node.shape), np.abs(op.resistor_current)
    axis, place = crossed_faces(netlist.cells.resistor_face, netlist.cells.space.shape)
    for end in range(2):
        chosen = netlist.resistor_nodes[:, end] == netlist.cells.obstacle_node
        # The lower side of a face is the first node of a resistor that points upwards.
        lower = netlist.cells.resistor_upward == (end == 0)
        tile = [(index - (lower & (axis == along)))[chosen] - ORIGIN[along] for along, index in enumerate(place.T)]
        np.add.at(taps, tuple(tile), amps[chosen])
    return taps


def _obstacle_drop(rules: LayoutRules, tile: TileGeometry, plan: RailPlan, taps: NDArray[np.float64]) -> float:
    """Return the largest voltage drop along the obstacle rail, in volts, at least 0.

    It counts from the lower ends of the rail's two vertical wires to a tile on one of its horizontal stripes. `taps`
    (columns + 2, rows + 2): magnitude of the current between the rail and every tile, in amperes.
    """
    sheet, count = rules.metals[1].sheet, taps.shape[0]
    segment = sheet * tile.px / (tile.stripe[1] - tile.stripe[0])
    place = np.arange(1, count + 1) / (count + 1)
    from_left = (taps * (1 - place[:, np.newaxis])).sum(axis=0)
    flowing = from_left - np.concatenate((np.zeros((1, taps.shape[1])), np.cumsum(taps, axis=0)[:-1]))
    along = np.cumsum(segment * flowing, axis=0).max(axis=0, initial=0.0)
    sides = np.stack((from_left, taps.sum(axis=0) - from_left))
    above = np.cumsum(sides[:, ::-1], axis=1)[:, ::-1]
    side = np.cumsum(sheet * tile.py / plan.ring * above, axis=1).max(axis=0)
    return float((along + side).max(initial=0.0))
