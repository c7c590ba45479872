"""Circuit diagrams: choice of the layout, and diagrams of netlists without cells, laid out by networkx."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from matplotlib.axes import Axes
from numpy.typing import NDArray
from scipy.spatial import KDTree
from shapely.geometry.base import BaseGeometry

from resgrid.circuit.operating_point import OperatingPoint
from resgrid.core.netlist import GROUND, Netlist
from resgrid.errors import InputError
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
"""Largest number of nodes, including ground, in a circuit diagram."""
_NODES_APART = 2.2
"""Distance between the two nearest nodes of a layout, in drawing units of 0.8 inches in a new figure.

The distance is smaller if the median distance of a node from its nearest node would otherwise exceed 4 units.
"""
_HALF_LENGTH, _HALF_SYMBOL = 0.3, 0.18
"""Half the length of an element with its leads, and without them, in drawing units."""
_LETTER = np.array([0.073, 0.15])
"""Assumed width of a letter and height of a line of text, in drawing units."""

_ELEMENTS = {
    "resistor": ("resistor_nodes", "conductance", "Ω"),
    "voltage source": ("source_nodes", "source_volts", "V"),
    "current source": ("current_nodes", "current_amps", "A"),
    "capacitor": ("capacitor_nodes", "capacitance", "F"),
}
"""Attributes of a netlist with the nodes and values of each kind of element, and the SI unit of the values."""

Place = NDArray[np.float64]
"""Coordinates of a point, shape (2,), or of several points, shape (n, 2), in drawing units."""
Elements = list[tuple[str, float, bool]]
"""Parallel elements: kind, value (in the kind's SI unit), and whether the first terminal has the higher node index."""
Groups = dict[tuple[int, int], Elements]
"""Parallel elements of every pair of nodes that elements connect; a key holds the two node indices, the higher one
first."""
Shapes = list[BaseGeometry]


@dataclass(frozen=True, eq=False)
class Branch:
    """An element of a circuit diagram.

    `kind`: key of `_ELEMENTS`; `value`: value in the kind's SI unit; `start`, `end` (2,): ends of the element with its
    leads, in drawing units; `outward` (2,): unit vector across the element, to the side where its value is preferably
    written.
    """

    kind: str
    value: float
    start: Place
    end: Place
    outward: Place

    @property
    def half_width(self) -> float:
        """Half the width of the symbol, measured across the element, in drawing units."""
        return _HALF_SYMBOL if "source" in self.kind else 0.1

    @property
    def symbol(self) -> BaseGeometry:
        """Rectangle of the symbol without its leads, as a polygon in drawing units."""
        along = np.array([self.outward[1], -self.outward[0]])
        ends = (self.start + self.end) / 2 + np.outer((-_HALF_SYMBOL, _HALF_SYMBOL), along)
        return shapely.LineString(ends).buffer(self.half_width, cap_style="flat")


@dataclass(frozen=True, eq=False)
class Bundle:
    """Parallel elements between two nodes of a circuit diagram.

    `branches`: the elements; `wires`: start and end (2,) of each wire, in drawing units, the two wires to the nodes
    first; `ground`: position (2,) and direction (2,) of a ground symbol, None if no end is ground.
    """

    branches: list[Branch]
    wires: list[tuple[Place, Place]]
    ground: tuple[Place, Place] | None = None

    @property
    def body(self) -> Shapes:
        """Polygons and lines of the elements and of the wires between them, without the two wires to the nodes."""
        lines = [*self.wires[2:], *((branch.start, branch.end) for branch in self.branches)]
        return [*(branch.symbol for branch in self.branches), *map(shapely.LineString, lines)]

    @property
    def shapes(self) -> Shapes:
        """Polygons and lines of all elements, all wires and the ground symbol."""
        ground = [] if self.ground is None else [shapely.Point(self.ground[0] + 0.1 * self.ground[1]).buffer(0.1)]
        return [*self.body, *map(shapely.LineString, self.wires[:2]), *ground]


def draw_circuit(netlist: Netlist, ax: Axes | None = None, *, op: OperatingPoint | None = None) -> Axes:
    """Draw the circuit diagram of a small netlist: nodes with names and voltages, elements with values.

    Nodes of a netlist compiled from one or two axes lie at the cell centres; other netlists are laid out as graphs.
    With another lattice than "square", only resistors are drawn.  `ax`: axes to draw on, by default those of a new
    figure; `op`: operating point of the netlist, whose node voltages are written into the diagram, None for none.
    Returns the axes.  Raises InputError for a nonlinear netlist, for the operating point of another netlist, for more
    than two axes or 10 cells along an axis, and without cells for more than 40 nodes.
    """
    if netlist.nonlinear_nodes.size:
        raise InputError("circuit diagrams have no symbol for nonlinear resistors; draw the field of this circuit")
    if op is not None and not op.is_of(netlist):
        raise InputError("the operating point belongs to another netlist; solve this one first")
    if netlist.lattice_map is not None:
        from resgrid.plot.lattices import draw_lattice_netlist

        return draw_lattice_netlist(netlist, ax)
    if netlist.cell_map is None or len(netlist.cells.resistor_face) != len(netlist.resistor_nodes):
        return _draw_graph(netlist, op, ax)
    shape = netlist.cells.space.shape
    if len(shape) > 2:
        raise InputError(f"a circuit diagram needs one or two axes, but this space has {len(shape)}; draw its field")
    if max(shape) > MOST_CELLS_A_SIDE:
        raise InputError(
            f"a circuit diagram of {' x '.join(map(str, shape))} cells is not legible; at most {MOST_CELLS_A_SIDE} per "
            "axis are drawn.  Draw its field, or use fewer cells"
        )
    return draw_compiled(netlist, op, ax)


def _draw_graph(netlist: Netlist, op: OperatingPoint | None, ax: Axes | None) -> Axes:
    """Draw the circuit diagram of a netlist without cells; return its axes.

    `op`: operating point with the voltages to write, None to omit them; `ax`: axes to draw on, None for a new figure.
    """
    if netlist.node_count > MOST_NODES:
        raise InputError(
            f"a circuit diagram of {netlist.node_count} nodes is not legible; at most {MOST_NODES} are drawn.  "
            "Read the values instead (op.voltage), or compile a space with fewer cells"
        )
    groups = _groups(netlist)
    place = _places(netlist, groups)
    bundles = _bundles(groups, place)
    texts = _texts(netlist, op, place, bundles)
    drawn = [*map(shapely.Point, place[1:]), *_all_shapes(bundles), *(box for _, box in texts)]
    left, bottom, right, top = (shapely.total_bounds(drawn) + np.array([-0.2, -0.2, 0.2, 0.2])).tolist()
    width, height = max(0.8 * (right - left), 2.0), max(0.8 * (top - bottom), 2.0)
    axes = new_figure(width, height).add_subplot() if ax is None else ax
    with symbols_on(axes) as drawing:
        for bundle in bundles:
            for branch in bundle.branches:
                add_symbol(drawing, branch.kind, branch.start, branch.end)
            for wire in bundle.wires:
                axes.plot(*np.stack(wire, axis=1), color=INK, linewidth=0.9, zorder=2)
            if bundle.ground is not None:
                add_ground(drawing, *bundle.ground)
    axes.scatter(place[1:, 0], place[1:, 1], s=20, color=INK, zorder=4)
    for text, box in texts:
        x, y = box.centroid.x, box.centroid.y
        axes.text(x, y, text, ha="center", va="center", fontsize=SMALL, path_effects=HALO, zorder=6)
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
    axes.set_axis_off()
    return axes


def _groups(netlist: Netlist) -> Groups:
    """Return the parallel elements of every pair of nodes, by the pair of node indices, the higher index first.

    An element is a tuple: kind, value in SI units, and whether its first terminal has the higher node index.
    """
    groups: Groups = {}
    for kind, (nodes, values, _) in _ELEMENTS.items():
        value = getattr(netlist, values)
        amounts = (1.0 / value if kind == "resistor" else value).tolist()
        for (a, b), amount in zip(getattr(netlist, nodes).tolist(), amounts, strict=True):
            groups.setdefault((max(a, b), min(a, b)), []).append((kind, amount, a > b))
    return groups


def _places(netlist: Netlist, groups: Groups) -> Place:
    """Return the positions (nodes, 2) of the nodes, in drawing units.

    The row of ground is zero and unused, since each element to ground has a ground symbol of its own.
    """
    import networkx as nx

    graph: nx.Graph[int] = nx.Graph()
    graph.add_nodes_from(range(1, netlist.node_count))
    for (high, low), elements in groups.items():
        if low not in (GROUND, high):
            graph.add_edge(high, low, weight=1.0 + 0.2 * (len(elements) - 1))
    place = np.zeros((netlist.node_count, 2))
    left = 0.0
    for part in sorted((sorted(part) for part in nx.connected_components(graph)), key=lambda nodes: nodes[0]):
        inside = graph.subgraph(part)
        edges = np.searchsorted(part, np.array(inside.edges, dtype=int).reshape(-1, 2))
        starts: list[Any] = [nx.circular_layout(inside), *(nx.random_layout(inside, seed=seed) for seed in range(4))]
        if nx.check_planarity(inside)[0]:
            starts.append(nx.planar_layout(inside))
        spreads = [nx.kamada_kawai_layout(inside, pos=start) for start in starts]
        layouts = [_oriented(np.array([spread[node] for node in part])) for spread in spreads]
        local = min(layouts, key=lambda places: _closeness(places[edges]))
        place[part] = local - (local[:, 0].min() - left, local[:, 1].min())
        left = float(place[part, 0].max()) + 2.6
    return place


def _oriented(places: Place) -> Place:
    """Return a layout, scaled to drawing units (at most 2.2 between the two nearest nodes) and turned.

    An elongated layout is turned horizontal, with the first node on the left.  `places` (n, 2): node positions of any
    scale; the result has the shape (n, 2).
    """
    centred = places - places.mean(axis=0)
    _, extent, axes = np.linalg.svd(np.concatenate([centred, np.zeros((1, 2))]), full_matrices=False)
    if extent[0] > 1.2 * extent[1]:
        along = axes[0] * (1.0 if centred[0] @ axes[0] <= 0 else -1.0)
        centred = centred @ np.array([along, [-along[1], along[0]]]).T
        centred[:, 1] *= extent[1] > 0.05 * extent[0]  # a chain is straight
    nearest = np.asarray(KDTree(centred).query(centred, k=[2])[0])
    scale = min(_NODES_APART / max(float(nearest.min()), 0.05), 4.0 / max(float(np.median(nearest)), 0.05))
    return np.asarray(centred * (scale or 1.0))


def _closeness(edges: NDArray[np.float64]) -> float:
    """Return the total length of the parts of connections that lie within 0.3 drawing units of another connection.

    `edges` (edges, 2, 2): both ends of each straight connection of two nodes, in drawing units.  At each end, 15 % of
    the length of a connection are ignored.
    """
    lines = np.array(shapely.linestrings(edges + 0.15 * (edges[:, ::-1] - edges)))
    near = shapely.length(shapely.intersection(lines[:, None], shapely.buffer(lines, 0.3)))
    return float(near.sum() - near.trace())


def _bundles(groups: Groups, place: Place) -> list[Bundle]:
    """Return one `Bundle` (parallel elements with their wires) per pair of nodes.

    Pairs without ground come first, then elements to ground and loops at one node.  `groups`: elements of each pair of
    node indices, the higher index first; `place` (nodes, 2): node positions, in drawing units.
    """
    nodes: Shapes = [*map(shapely.Point, place[1:])]
    lines = {pair: shapely.LineString(place[list(pair)]) for pair in groups if GROUND not in pair and len({*pair}) == 2}
    bundles: list[Bundle] = []
    for pair in lines:
        a, b = place[pair[0]], place[pair[1]]
        choices = [_bundle(groups[pair], a, b, slide) for slide in (0.5, 0.4, 0.6, 0.32, 0.68)]
        drawn = [*nodes, *(lines[other] for other in lines if other != pair), *_all_shapes(bundles)]
        bundles.append(choices[_roomiest([choice.body for choice in choices], drawn, 0.2)])
    for (node, low), elements in groups.items():
        if node != GROUND and low in (GROUND, node):
            to_where = _to_ground if low == GROUND else _to_itself
            bundles.append(to_where(elements, place[node], [*nodes, *_all_shapes(bundles)]))
    return bundles


def _to_ground(elements: Elements, node: Place, drawn: Shapes) -> Bundle:
    """Return the parallel elements from a node to ground, as a `Bundle`: downwards, or in the direction with more room.

    `elements`: kind, value, and whether the first terminal has the higher node index, of each element; `node` (2,):
    position of the node; `drawn`: polygons and lines that the elements should not overlap.
    """
    around = shapely.Point(node).buffer(0.4).boundary
    arms = shapely.get_coordinates(shapely.intersection(drawn, around)) - node
    angles = np.sort(np.arctan2(arms[:, 1], arms[:, 0])) if len(arms) else np.zeros(1)
    sectors = np.diff(angles, append=angles[0] + 2 * np.pi)
    middles = (angles + sectors / 2)[np.argsort(-sectors)[:4]].tolist()
    choices = [
        _bundle(elements, node, node + length * np.array([np.cos(angle), np.sin(angle)]), slide, grounded=True)
        for length, slide in ((1.15, 0.6), (1.7, 0.72))
        for angle in (-np.pi / 2, *middles, 0.0, np.pi, np.pi / 2)
    ]
    return choices[_roomiest([choice.shapes for choice in choices], drawn, 0.28, shapely.Point(node).buffer(0.3))]


def _to_itself(elements: Elements, node: Place, drawn: Shapes) -> Bundle:
    """Return the elements with both ends at one node as nested loops, in the direction with the most room.

    `elements`: kind, value in SI units, and False (loops have no orientation) for each element; `node` (2,): position
    of the node; `drawn`: polygons and lines that the loops should not overlap.
    """
    angles = np.pi / 4 * (np.arange(8) + 2)
    choices = [_loop(elements, node, np.array([np.cos(angle), np.sin(angle)])) for angle in angles.tolist()]
    return choices[_roomiest([choice.body for choice in choices], drawn, 0.4, shapely.Point(node).buffer(0.3))]


def _loop(elements: Elements, node: Place, out: Place) -> Bundle:
    """Return nested loops, one per element, with both ends at the position `node` (2,), as a `Bundle`.

    `elements`: kind, value in SI units, and False (loops have no orientation) for each element; `out` (2,): unit vector
    from the node to the loops.
    """
    across = np.array([-out[1], out[0]])
    middles = [node + (0.8 + 0.75 * rank) * out for rank in range(len(elements))]
    lower, upper = ([middle + side * _HALF_LENGTH * across for middle in middles] for side in (-1.0, 1.0))
    branches = [
        Branch(kind, value, first if forward else last, last if forward else first, out)
        for (kind, value, forward), first, last in zip(elements, lower, upper, strict=True)
    ]
    return Bundle(branches, [(node, lower[0]), (node, upper[0]), (lower[0], lower[-1]), (upper[0], upper[-1])])


def _bundle(elements: Elements, a: Place, b: Place, slide: float, *, grounded: bool = False) -> Bundle:
    """Return parallel elements with their wires, symmetrical about the line between the positions `a` and `b` (2,).

    `elements`: kind, value, and whether the element points from `a` to `b`, of each element; `slide`: position of the
    elements between `a` (0) and `b` (1); `grounded`: whether `b` has a ground symbol.
    """
    length = max(float(np.linalg.norm(b - a)), 1e-9)
    along = (b - a) / length
    across = np.array([-along[1], along[0]])
    across = across if across @ (1.0, 1.0) > 0 else -across  # a single value is written above or to the right
    aside = (0.68 + 0.35 * abs(along[1])) * (np.arange(len(elements)) - (len(elements) - 1) / 2)
    half = min(_HALF_LENGTH, 0.3 * length) * along
    middle = a + slide * (b - a)
    branches = []
    for (kind, value, forward), side in zip(elements, aside.tolist(), strict=True):
        ends = middle + side * across - half, middle + side * across + half
        start, end = ends if forward else ends[::-1]
        branches.append(Branch(kind, value, start, end, -across if side < 0 else across))
    wires = [(a, middle - half), (middle + half, b)]
    if len(elements) > 1:
        wires += [(at + aside[0] * across, at + aside[-1] * across) for at in (middle - half, middle + half)]
    return Bundle(branches, wires, (b, along) if grounded else None)


def _texts(
    netlist: Netlist, op: OperatingPoint | None, place: Place, bundles: list[Bundle]
) -> list[tuple[str, BaseGeometry]]:
    """Return each text of the diagram with its rectangle: values of elements, names and voltages of nodes.

    `netlist`: the circuit; `op`: operating point with the voltages, None to omit them; `place` (nodes, 2): node
    positions in drawing units; `bundles`: elements with their wires, which the texts should not overlap.
    """
    drawn = [*map(shapely.Point, place[1:]), *_all_shapes(bundles)]
    texts: list[tuple[str, BaseGeometry]] = []

    def write(text: str, anchors: list[tuple[Place, Place]]) -> None:
        lines = text.split("\n")
        half = _LETTER * (max(map(len, lines)), len(lines)) / 2
        centres = [at + side * (np.abs(side) @ half) for at, side in anchors]
        boxes = [shapely.box(*(centre - half), *(centre + half)) for centre in centres]
        best = boxes[_roomiest([[box] for box in boxes], drawn, 0.07)]
        texts.append((text, best))
        drawn.append(best)

    centre = place[1:].mean(axis=0)
    for branch, lone in ((branch, len(bundle.branches) == 1) for bundle in bundles for branch in bundle.branches):
        middle, along = (branch.start + branch.end) / 2, branch.end - branch.start
        first = -branch.outward if lone and branch.outward @ (middle - centre) < -0.3 else branch.outward
        gap, sides = 0.08 + branch.half_width, (first, -first)
        anchors = [(middle + gap * side + slide * along, side) for slide in (0.0, 0.25, -0.25) for side in sides]
        write(format_quantity(branch.value, _ELEMENTS[branch.kind][2], 3), anchors)
    nodes = np.arange(1, netlist.node_count)
    volts, unit = voltage_texts(op, nodes)
    angles = np.pi / 4 * np.array([3, 1, 5, 7, 2, 4, 0, 6])
    around = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    for at, name, text in zip(place[1:], netlist.names_of(nodes), volts, strict=True):
        anchors = [(at + gap * side, side) for gap in (0.1, 0.25, 0.5) for side in around]
        write(f"{name}\n{text} {unit}" if text else name, anchors)
    return texts


def _all_shapes(bundles: list[Bundle]) -> Shapes:
    """Return the polygons and lines of all elements, wires and ground symbols of bundles (parallel elements)."""
    return [shape for bundle in bundles for shape in bundle.shapes]


def _roomiest(choices: list[Shapes], drawn: Shapes, enough: float, within: BaseGeometry | None = None) -> int:
    """Return the index of the entry of `choices` with the largest distance from the shapes that are already drawn.

    `choices`: alternative lists of polygons and lines; `drawn`: polygons and lines that are already drawn; `enough`:
    distance, in drawing units, at which larger distances are cut off, so that the first of several such entries is
    returned; `within`: area whose points are ignored, such as the common node of the shapes, None for no area.
    """
    touched = shapely.Point() if within is None else within
    others, *bodies = (shapely.difference(shapes, touched) for shapes in (drawn, *choices))
    room = [np.fmin.reduce(shapely.distance(body[:, np.newaxis], others), axis=None, initial=enough) for body in bodies]
    return int(np.argmax(room))
