"""Pictures of circuits: the door for all of them, and those without cells, placed by networkx."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.netlist import GROUND, Netlist
from resgrid.nodal.operating_point import OperatingPoint
from resgrid.plot.circuits import (
    HALO,
    INK,
    MOST_CELLS_A_SIDE,
    add_ground,
    add_symbol,
    draw_compiled,
    symbols_on,
    voltage_texts,
)  # fmt: skip
from resgrid.plot.figures import new_figure
from resgrid.plot.style import SMALL
from resgrid.scene.quantities import format_quantity

MOST_NODES = 40
_STUB = 0.9
"""Length of an element to ground."""

_APART = 1.1
"""Between elements to ground of one node."""

_ELEMENTS = {
    "resistor": ("resistor_nodes", "conductance", "Ω"),
    "voltage source": ("source_nodes", "source_volts", "V"),
    "current source": ("current_nodes", "current_amps", "A"),
    "capacitor": ("capacitor_nodes", "capacitance", "F"),
}
"""Where a netlist keeps every kind of element, and the unit of what is written beside it."""

Place = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Branch:
    """An element on paper: its ends, the wires that lead there, and where a ground symbol goes, if one does."""

    kind: str
    value: float
    start: Place
    end: Place
    wires: tuple[tuple[Place, Place], ...] = ()
    ground: Place | None = None


def draw_circuit(netlist: Netlist, ax: Axes | None = None, *, op: OperatingPoint | None = None) -> Axes:
    """Draw a small netlist as a circuit: nodes with names and voltages, elements with values.

    One compiled from a space of one or two axes is drawn where its cells are; the others by their graph.
    """
    if netlist.nonlinear_nodes.size:
        raise InputError("a circuit with nonlinear resistors is not drawn; draw its field")
    if op is not None and not op.is_of(netlist):
        raise InputError("the operating point belongs to another netlist; solve this one first")
    if netlist.cell_map is None or len(netlist.cells.resistor_face) != len(netlist.resistor_nodes):
        return _draw_graph(netlist, op, ax)
    shape = netlist.cells.space.shape
    if len(shape) > 2:
        raise InputError(f"a circuit is drawn for one or two axes, this space has {len(shape)}; draw its field")
    if max(shape) > MOST_CELLS_A_SIDE:
        raise InputError(
            f"a circuit of {' x '.join(map(str, shape))} cells cannot be read; at most {MOST_CELLS_A_SIDE} a side are "
            "drawn.  Draw its field, or sample the scene more coarsely"
        )
    return draw_compiled(netlist, op, ax)


def _draw_graph(netlist: Netlist, op: OperatingPoint | None, ax: Axes | None) -> Axes:
    if netlist.node_count > MOST_NODES:
        raise InputError(
            f"a circuit of {netlist.node_count} nodes cannot be read; at most {MOST_NODES} are drawn.  "
            "Look at its values instead, or compile a coarser space"
        )
    place = _places(netlist)
    branches = _branches(netlist, place)
    corners = np.concatenate([place[1:], *(np.array([branch.start, branch.end]) for branch in branches)])
    left, bottom = np.subtract(corners.min(axis=0), (1.0, 0.4))
    right, top = np.add(corners.max(axis=0), (1.1, 0.6))
    width, height = max(0.8 * (right - left), 2.0), max(0.8 * (top - bottom), 2.0)
    axes = new_figure(width, height).add_subplot() if ax is None else ax
    with symbols_on(axes) as drawing:
        for branch in branches:
            add_symbol(drawing, branch.kind, branch.start, branch.end)
            _write_value(branch, axes)
            for wire in branch.wires:
                axes.plot(*np.stack(wire, axis=1), color=INK, linewidth=0.9, zorder=2)
            if branch.ground is not None:
                add_ground(drawing, branch.ground)
    _draw_nodes(netlist, op, place, branches, axes)
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
    axes.set_axis_off()
    return axes


def _places(netlist: Netlist) -> Place:
    """Where the nodes go; about one unit apart.  Ground has a symbol wherever it is needed instead of a place."""
    import networkx as nx

    graph: nx.Graph[int] = nx.Graph()
    graph.add_nodes_from(range(1, netlist.node_count))
    for nodes, *_ in _ELEMENTS.values():
        graph.add_edges_from((a, b) for a, b in getattr(netlist, nodes).tolist() if GROUND not in (a, b) and a != b)
    place = np.zeros((netlist.node_count, 2))
    left = 0.0
    for part in sorted((sorted(part) for part in nx.connected_components(graph)), key=lambda nodes: nodes[0]):
        spread = nx.kamada_kawai_layout(graph.subgraph(part)) if len(part) > 1 else {part[0]: np.zeros(2)}
        local = np.array([spread[node] for node in part])
        nearest = _nearest(local)
        local = local * (1.9 / nearest if np.isfinite(nearest) else 1.0)
        place[part] = local - (local[:, 0].min() - left, local[:, 1].min())
        left = float(place[part, 0].max()) + 2.6
    return place


def _nearest(places: Place) -> float:
    distance = np.linalg.norm(places[:, None] - places, axis=2)
    np.fill_diagonal(distance, np.inf)
    return max(float(distance.min(initial=np.inf)), 0.05)


def _branches(netlist: Netlist, place: Place) -> list[Branch]:
    """Places of all elements: parallel ones side by side, those to ground fanned out below their node."""
    branches: list[Branch] = []
    ranks: dict[tuple[int, int], int] = {}
    for kind, (nodes, values, _) in _ELEMENTS.items():
        value = getattr(netlist, values)
        amounts = (1.0 / value if kind == "resistor" else value).tolist()
        for (a, b), amount in zip(getattr(netlist, nodes).tolist(), amounts, strict=True):
            low, high = sorted((a, b))
            rank = ranks[low, high] = ranks.get((low, high), -1) + 1
            branches.append(
                _to_ground(kind, amount, place[high], rank, up=a == low)
                if low == GROUND
                else _between(kind, amount, place[a], place[b], rank, forward=a < b)
            )
    return branches


def _to_ground(kind: str, value: float, node: Place, rank: int, *, up: bool) -> Branch:
    """An element from ground up to a node, or down, beside ``rank`` others."""
    corner = np.add(node, (_APART * rank, 0.0))
    ground = np.subtract(corner, (0.0, _STUB))
    start, end = (ground, corner) if up else (corner, ground)
    return Branch(kind, value, start, end, ((node, corner),) if rank else (), ground)


def _between(kind: str, value: float, a: Place, b: Place, rank: int, *, forward: bool) -> Branch:
    """An element beside ``rank`` others between the same nodes, alternating sides, with wires that lead there."""
    if rank == 0:
        return Branch(kind, value, a, b)
    along = b - a
    side = (1 if rank % 2 else -1) * (1 if forward else -1) * ((rank + 1) // 2)
    aside = 0.5 * side * np.array([-along[1], along[0]]) / max(float(np.linalg.norm(along)), 1e-9)
    start, end = a + 0.15 * along + aside, b - 0.15 * along + aside
    return Branch(kind, value, start, end, ((a, start), (end, b)))


def _write_value(branch: Branch, axes: Axes) -> None:
    """The value of an element: to the right of a steep one, else above it."""
    along = np.abs(branch.end - branch.start)
    steep = along[1] > along[0]
    x, y = ((branch.start + branch.end) / 2 + ((0.24, 0.0) if steep else (0.0, 0.22))).tolist()
    text = format_quantity(branch.value, _ELEMENTS[branch.kind][2], 3)
    axes.text(
        x, y, text, ha="left" if steep else "center", va="center", fontsize=SMALL, path_effects=HALO, zorder=6
    )  # fmt: skip


def _draw_nodes(netlist: Netlist, op: OperatingPoint | None, place: Place, branches: list[Branch], axes: Axes) -> None:
    nodes = np.arange(1, netlist.node_count)
    axes.scatter(place[1:, 0], place[1:, 1], s=20, color=INK, zorder=4)
    texts, unit = voltage_texts(op, nodes)
    for at, name, text in zip(place[1:], netlist.names_of(nodes), texts, strict=True):
        x, y = _free_side(at, branches)
        axes.text(
            float(at[0] + 0.15 * x), float(at[1] + 0.12 * y), f"{name}\n{text} {unit}" if text else name,
            fontsize=SMALL, path_effects=HALO, zorder=6, ha="left" if x > 0 else "right",
            va="bottom" if y > 0 else "top",
        )  # fmt: skip


def _free_side(at: Place, branches: list[Branch]) -> tuple[int, int]:
    """The quadrant around a node, as signs, that is farthest from what is joined to it."""
    ends = [
        (far - at) / max(float(np.linalg.norm(far - at)), 1e-9)
        for branch in branches
        for near, far in ((branch.start, branch.end), (branch.end, branch.start), *branch.wires)
        if np.allclose(near, at)
    ]
    quadrants = [(-1, 1), (-1, -1), (1, 1), (1, -1)]  # the left first: values are written on the right
    return min(quadrants, key=lambda sign: max((float(np.dot(sign, end)) for end in ends), default=0.0))
