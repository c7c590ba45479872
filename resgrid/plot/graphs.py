"""Small circuits without a map of cells: placed by networkx, drawn with the same symbols."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.netlist import GROUND, Netlist
from resgrid.nodal.operating_point import OperatingPoint
from resgrid.plot.figures import new_figure
from resgrid.plot.style import SMALL
from resgrid.plot.symbols import (
    INK,
    draw_capacitor,
    draw_current_source,
    draw_ground,
    draw_supply,
    engineering,
    zigzag,
)
from resgrid.plot.voltages import voltage_texts

MOST_NODES = 40
_HALO = [withStroke(linewidth=2.0, foreground="white")]
_UNITS = {"resistor": "Ω", "voltage source": "V", "current source": "A", "capacitor": "F"}
_STUB = 0.9


@dataclass(frozen=True, eq=False)
class Branch:
    """An element on paper: its ends, the wires that lead there, and where a ground symbol goes, if one does."""

    kind: str
    value: float
    start: NDArray[np.float64]
    end: NDArray[np.float64]
    wires: tuple[tuple[NDArray[np.float64], NDArray[np.float64]], ...]
    ground: NDArray[np.float64] | None


def plot_graph(netlist: Netlist, op: OperatingPoint | None = None, ax: Axes | None = None) -> Axes:
    """Draw a small netlist that belongs to no space."""
    if netlist.node_count > MOST_NODES:
        raise InputError(
            f"a circuit of {netlist.node_count} nodes cannot be read; at most {MOST_NODES} are drawn.  "
            "Look at its values instead, or compile a coarser space"
        )
    place = _places(netlist)
    branches = _branches(netlist, place)
    corners = np.concatenate([place[1:], *(np.array([branch.start, branch.end]) for branch in branches)])
    axes = _new_axes(corners) if ax is None else ax
    resistors = [branch for branch in branches if branch.kind == "resistor"]
    if resistors:
        lines = zigzag(np.array([each.start for each in resistors]), np.array([each.end for each in resistors]))
        axes.add_collection(
            LineCollection(list(lines), colors=INK, linewidths=0.9, zorder=2, gid="resistors"), autolim=False
        )
    for branch in branches:
        _draw_branch(axes, branch)
    _draw_nodes(netlist, op, place, branches, axes)
    _finish(axes, corners)
    return axes


def _places(netlist: Netlist) -> NDArray[np.float64]:
    """Where the nodes go; about one unit apart.  Ground has a symbol wherever it is needed instead of a place."""
    import networkx as nx

    graph: nx.Graph[int] = nx.Graph()
    graph.add_nodes_from(range(1, netlist.node_count))
    for nodes in (netlist.resistor_nodes, netlist.source_nodes, netlist.current_nodes, netlist.capacitor_nodes):
        graph.add_edges_from((a, b) for a, b in nodes.tolist() if GROUND not in (a, b) and a != b)
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


def _nearest(places: NDArray[np.float64]) -> float:
    distance = np.linalg.norm(places[:, None] - places, axis=2)
    np.fill_diagonal(distance, np.inf)
    return max(float(distance.min(initial=np.inf)), 0.05)


def _branches(netlist: Netlist, place: NDArray[np.float64]) -> list[Branch]:
    """Places of all elements: parallel ones side by side, those to ground fanned out below their node."""
    grounded: dict[int, int] = {}
    parallel: dict[tuple[int, int], int] = {}
    branches: list[Branch] = []
    for kind, value, a, b in _elements(netlist):
        if GROUND in (a, b):
            node = max(a, b)
            rank = grounded.get(node, 0)
            grounded[node] = rank + 1
            loose = place[node] + (1.1 * rank, -_STUB)
            corner = place[node] + (1.1 * rank, 0.0)
            start, end = (corner, loose) if a == node else (loose, corner)
            branches.append(Branch(kind, value, start, end, ((place[node], corner),) if rank else (), loose))
            continue
        pair = min(a, b), max(a, b)
        rank = parallel.get(pair, 0)
        parallel[pair] = rank + 1
        branches.append(_beside(kind, value, place[a], place[b], rank, forward=a < b))
    return branches


def _elements(netlist: Netlist) -> Iterator[tuple[str, float, int, int]]:
    for kind, nodes, values in (
        ("resistor", netlist.resistor_nodes, 1.0 / netlist.conductance),
        ("voltage source", netlist.source_nodes, netlist.source_volts),
        ("current source", netlist.current_nodes, netlist.current_amps),
        ("capacitor", netlist.capacitor_nodes, netlist.capacitance),
    ):
        for (a, b), value in zip(nodes.tolist(), values.tolist(), strict=True):
            yield kind, value, a, b


def _beside(
    kind: str, value: float, a: NDArray[np.float64], b: NDArray[np.float64], rank: int, *, forward: bool
) -> Branch:
    """An element beside ``rank`` others between the same nodes, alternating sides, with wires that lead there."""
    if rank == 0:
        return Branch(kind, value, a, b, (), None)
    along = b - a
    side = (1 if rank % 2 else -1) * (1 if forward else -1) * ((rank + 1) // 2)
    aside = 0.5 * side * np.array([-along[1], along[0]]) / max(float(np.linalg.norm(along)), 1e-9)
    start, end = a + 0.15 * along + aside, b - 0.15 * along + aside
    return Branch(kind, value, start, end, ((a, start), (end, b)), None)


def _draw_branch(axes: Axes, branch: Branch) -> None:
    start, end = branch.start, branch.end
    if branch.kind == "voltage source":
        draw_supply(axes, start, end)
    elif branch.kind == "current source":
        draw_current_source(axes, start, end)
    elif branch.kind == "capacitor":
        draw_capacitor(axes, start, end)
    for wire in branch.wires:
        axes.plot(*np.stack(wire, axis=1), color=INK, linewidth=0.9, zorder=2)
    if branch.ground is not None:
        draw_ground(axes, branch.ground)
    along = end - start
    steep = abs(along[1]) > 0.5 * abs(along[0])
    x, y = ((start + end) / 2 + ((0.26, 0.0) if steep else (0.0, 0.26))).tolist()
    axes.text(
        x, y, engineering(branch.value, _UNITS[branch.kind]), ha="left" if steep else "center", va="center",
        fontsize=SMALL, path_effects=_HALO, zorder=6,
    )  # fmt: skip


def _draw_nodes(
    netlist: Netlist, op: OperatingPoint | None, place: NDArray[np.float64], branches: list[Branch], axes: Axes
) -> None:
    nodes = np.arange(1, netlist.node_count)
    axes.scatter(place[1:, 0], place[1:, 1], s=20, color=INK, zorder=4)
    texts, unit = voltage_texts(op, nodes)
    for at, name, text in zip(place[1:], netlist.names_of(nodes), texts, strict=True):
        label = f"{name}\n{text} {unit}" if text else name
        x, y = _free_side(at, branches)
        axes.text(
            float(at[0] + 0.15 * x), float(at[1] + 0.12 * y), label, fontsize=SMALL, path_effects=_HALO, zorder=6,
            ha="left" if x > 0 else "right", va="bottom" if y > 0 else "top",
        )  # fmt: skip


def _free_side(at: NDArray[np.float64], branches: list[Branch]) -> tuple[int, int]:
    """The quadrant around a node, as signs, that is farthest from what is joined to it."""
    ends = [
        (far - at) / max(float(np.linalg.norm(far - at)), 1e-9)
        for branch in branches
        for near, far in ((branch.start, branch.end), (branch.end, branch.start), *branch.wires)
        if np.allclose(near, at)
    ]
    quadrants = [(-1, 1), (-1, -1), (1, 1), (1, -1)]  # the left first: values are written on the right
    return min(quadrants, key=lambda sign: max((float(np.dot(sign, end)) for end in ends), default=0.0))


def _finish(axes: Axes, corners: NDArray[np.float64]) -> None:
    left, right, bottom, top = _limits(corners)
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
    axes.set_axis_off()


def _limits(corners: NDArray[np.float64]) -> tuple[float, float, float, float]:
    (left, bottom), (right, top) = corners.min(axis=0), corners.max(axis=0)
    return left - 1.0, right + 1.1, bottom - 0.4, top + 0.6


def _new_axes(corners: NDArray[np.float64]) -> Axes:
    left, right, bottom, top = _limits(corners)
    return new_figure(max(0.8 * (right - left), 2.0), max(0.8 * (top - bottom), 2.0)).add_subplot()
