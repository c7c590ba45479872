"""Where the faces of a grid lie on the die, and how passes add to a netlist.

Extra resistors are appended, so that those of the grid keep their numbers; they cross no face (-1).
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.netlist import GROUND, CellMap, Netlist


def layout_of(netlist: Netlist, what: str) -> CellMap:
    """The map of cells of a netlist, which some effect needs."""
    if netlist.cell_map is None:
        raise InputError(f"{what} belong to cells, and this netlist was not compiled from a space")
    return netlist.cells


def tiled_layout(netlist: Netlist, what: str) -> CellMap:
    """The map of cells of a netlist with one node per cell."""
    cell_map = layout_of(netlist, what)
    if cell_map.wiring.rails != "cells":
        raise InputError(f"{what} need one node per cell; compile with rails = 'cells'")
    return cell_map


def face_places(cell_map: CellMap) -> NDArray[np.float64]:
    """Where the centre of every face lies on the die.  Returns (faces, ndim)."""
    shape = cell_map.space.shape
    parts = []
    for axis in range(len(shape)):
        ticks = [(np.arange(n) + 0.5) / n for n in shape]
        ticks[axis] = np.arange(shape[axis] + 1) / shape[axis]
        parts.append(np.stack([part.ravel() for part in np.meshgrid(*ticks, indexing="ij")], axis=1))
    return np.concatenate(parts)


def add_nodes(netlist: Netlist, count: int) -> tuple[Netlist, NDArray[np.int32]]:
    """Append nodes; returns the netlist and their numbers."""
    first = netlist.node_count
    names = netlist.node_names
    if names is not None:
        names = (*names, *(f"node_{node}" for node in range(first, first + count)))
    return netlist.replace(node_count=first + count, node_names=names), np.arange(first, first + count, dtype=np.int32)


def add_resistors(
    netlist: Netlist,
    nodes: NDArray[np.int32],
    conductance: NDArray[np.float64],
    face: NDArray[np.int64] | None = None,
) -> Netlist:
    """Append resistors without temperature coefficients.

    Shapes: `nodes` (n, 2), `conductance` (n,), `face` (n,).
    """
    count, cell_map = len(conductance), netlist.cells
    if cell_map is not None:
        crossed = np.full(count, -1, dtype=np.int64) if face is None else face
        cell_map = dataclasses.replace(
            cell_map,
            resistor_face=np.append(cell_map.resistor_face, crossed),
            resistor_upward=np.append(cell_map.resistor_upward, np.ones(count, dtype=np.bool_)),
        )
    return netlist.replace(
        resistor_nodes=np.concatenate([netlist.resistor_nodes, nodes]),
        conductance=np.append(netlist.conductance, conductance),
        tc1=None if netlist.tc1 is None else np.append(netlist.tc1, np.zeros(count)),
        tc2=None if netlist.tc2 is None else np.append(netlist.tc2, np.zeros(count)),
        element_names=None,
        cell_map=cell_map,
    )


def keep_resistors(netlist: Netlist, keep: NDArray[np.bool_]) -> Netlist:
    """Leave out resistors, shape of ``keep`` (resistors,)."""
    cell_map = netlist.cell_map
    if cell_map is not None:
        cell_map = dataclasses.replace(
            cell_map, resistor_face=cell_map.resistor_face[keep], resistor_upward=cell_map.resistor_upward[keep]
        )
    return netlist.replace(
        resistor_nodes=netlist.resistor_nodes[keep],
        conductance=netlist.conductance[keep],
        tc1=None if netlist.tc1 is None else netlist.tc1[keep],
        tc2=None if netlist.tc2 is None else netlist.tc2[keep],
        element_names=None,
        cell_map=cell_map,
    )


def keep_nonlinear(netlist: Netlist, keep: NDArray[np.bool_]) -> Netlist:
    """Leave out nonlinear resistors, shape of ``keep`` (nonlinear resistors,)."""
    cell_map = netlist.cell_map
    if cell_map is not None:
        cell_map = dataclasses.replace(
            cell_map, nonlinear_face=cell_map.nonlinear_face[keep], nonlinear_upward=cell_map.nonlinear_upward[keep]
        )
    return netlist.replace(
        nonlinear_nodes=netlist.nonlinear_nodes[keep],
        nonlinear_current=netlist.nonlinear_current[keep],
        nonlinear_voltage=netlist.nonlinear_voltage[keep],
        element_names=None,
        cell_map=cell_map,
    )


def add_sources(netlist: Netlist, nodes: NDArray[np.int32], volts: NDArray[np.float64]) -> Netlist:
    """Append voltage sources, shapes (n, 2) and (n,)."""
    return netlist.replace(
        source_nodes=np.concatenate([netlist.source_nodes, nodes]),
        source_volts=np.append(netlist.source_volts, volts),
        element_names=None,
    )


def supply_node(netlist: Netlist, rail: str) -> tuple[Netlist, int]:
    """The pin of a rail, made if there is none: where currents drive the chip, both are at the goal's voltage."""
    cell_map = tiled_layout(netlist, "rails")
    wiring = cell_map.wiring
    known = cell_map.obstacle_node if rail == "obstacle" else cell_map.goal_nodes[0] if cell_map.goal_nodes else -1
    if known >= 0:
        return netlist, known
    netlist, (node,) = add_nodes(netlist, 1)
    volts = wiring.high if rail == "obstacle" and wiring.drive != "uniform" else wiring.goal_voltage
    netlist = add_sources(netlist, np.array([[node, GROUND]]), np.array([volts]))
    changed: dict[str, object] = {"obstacle_node": int(node)} if rail == "obstacle" else {"goal_nodes": (int(node),)}
    return netlist.replace(cell_map=dataclasses.replace(cell_map, **changed)), int(node)  # type: ignore[arg-type]
