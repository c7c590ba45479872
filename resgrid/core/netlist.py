"""The class `Netlist` (resistors, sources and capacitors as arrays), and functions that add or select its elements."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid._internal.numbers import check_whole
from resgrid._internal.values import frozen
from resgrid.core.cell_map import CellMap
from resgrid.core.lattice import require_square
from resgrid.core.lattice_map import LatticeMap
from resgrid.core.networkx_graphs import (
    ARRAYS,
    all_within,
    check_element_names,
    check_node_names,
    column_of,
    fields_of,
    graph_of,
    no_pairs,
    no_values,
    node_numbers,
)
from resgrid.errors import InputError

if TYPE_CHECKING:
    import networkx as nx


GROUND = 0
MOST_NODES = 2**31 - 1
"""Largest number of nodes, since node numbers are int32."""

_FACES = {
    "resistor": ("resistor_face", "resistor_upward"),
    "nonlinear resistor": ("nonlinear_face", "nonlinear_upward"),
}
"""Names of two fields of a `CellMap` by kind of element: crossed faces, and whether first nodes are on lower sides."""


@frozen
@dataclass(frozen=True, eq=False)
class Netlist:
    """A circuit as a structure of arrays.  Node 0 is ground.

    Parameters
    ----------
    node_count : int
        Number of nodes, ground included.
    resistor_nodes : array_like of int, shape (m, 2)
        Both nodes of every resistor.
    conductance : array_like of float, shape (m,)
        Conductance of every resistor at the nominal temperature, in siemens; positive and finite.
    source_nodes, source_volts : array_like, shapes (s, 2) and (s,)
        Ideal voltage sources: plus node and minus node; volts.
    current_nodes, current_amps : array_like, shapes (c, 2) and (c,)
        Ideal current sources: the node that the current leaves and the node that it enters; amperes.
    capacitor_nodes, capacitance : array_like, shapes (k, 2) and (k,)
        Capacitors, in farads; open circuits in an operating point.
    tc1, tc2 : array_like of float, shape (m,), optional
        Temperature coefficients of the resistors, in 1/K and 1/K^2: at ``dT`` above the nominal temperature, the
        resistance is multiplied by ``1 + tc1 dT + tc2 dT^2``.  None for no dependence.
    nonlinear_nodes, nonlinear_current, nonlinear_voltage : array_like, shapes (q, 2), (q,) and (q,)
        Nonlinear resistors with the current ``I0 tanh((V_a - V_b) / V0)`` from the first node ``a`` to the second node
        ``b``, with ``I0 > 0`` in amperes and ``V0 > 0`` in volts (the horizontal resistor of Mead, *Analog VLSI and
        Neural Systems*, 1989, chapter 7).
    cell_map : CellMap, optional
        Map between the nodes and the cells of a configuration space.
    lattice_map : LatticeMap, optional
        Map between the nodes and the sites of a lattice other than "square" over a configuration space.
    node_names, element_names : optional
        Names read from a file: one string per node; and for each kind (``"resistor"``, ``"voltage source"``,
        ``"current source"``, ``"capacitor"``, ``"nonlinear resistor"``) one string per element.  By default names are
        generated on demand.

    Raises
    ------
    InputError
        If a shape does not match, a node does not exist or a value is not admissible.

    Examples
    --------
    >>> divider = rg.Netlist(3, [[1, 2], [2, 0]], [1e-3, 3e-3], source_nodes=[[1, 0]], source_volts=[2.0])
    >>> divider
    <Netlist of 3 nodes: 2 resistors, 1 voltage source>
    >>> rg.solve(divider).voltage.round(9)
    array([0. , 2. , 0.5])
    >>> graph = divider.to_networkx()
    >>> [(a, b, edge["kind"]) for a, b, edge in graph.edges(data=True)]
    [(0, 2, 'resistor'), (0, 1, 'voltage source'), (1, 2, 'resistor')]
    >>> rg.Netlist.from_networkx(graph).replace(source_volts=[4.0]).source_volts
    array([4.])
    """

    node_count: int
    resistor_nodes: NDArray[np.int32]
    conductance: NDArray[np.float64]
    source_nodes: NDArray[np.int32] = field(default_factory=no_pairs)
    source_volts: NDArray[np.float64] = field(default_factory=no_values)
    current_nodes: NDArray[np.int32] = field(default_factory=no_pairs)
    current_amps: NDArray[np.float64] = field(default_factory=no_values)
    capacitor_nodes: NDArray[np.int32] = field(default_factory=no_pairs)
    capacitance: NDArray[np.float64] = field(default_factory=no_values)
    tc1: NDArray[np.float64] | None = None
    tc2: NDArray[np.float64] | None = None
    cell_map: CellMap | None = None
    node_names: tuple[str, ...] | None = None
    element_names: Mapping[str, tuple[str, ...]] | None = None
    nonlinear_nodes: NDArray[np.int32] = field(default_factory=no_pairs)
    nonlinear_current: NDArray[np.float64] = field(default_factory=no_values)
    nonlinear_voltage: NDArray[np.float64] = field(default_factory=no_values)
    lattice_map: LatticeMap | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.node_count, int | np.integer) or not 1 <= self.node_count <= MOST_NODES:
            raise InputError(f"node_count = {self.node_count!r} must be a whole number from 1 to {MOST_NODES:,}")
        for nodes, *values in ARRAYS.values():
            object.__setattr__(self, nodes, node_numbers(nodes, getattr(self, nodes), self.node_count))
            for name in values:
                if not (getattr(self, name) is None and name in ("tc1", "tc2")):
                    object.__setattr__(self, name, column_of(name, getattr(self, name), 0, np.float64))
        for kind, names in ARRAYS.items():
            self._check_kind(kind, names)
        if not all_within(self.conductance, 0.0, np.inf):
            bad = int(np.flatnonzero(~(np.isfinite(self.conductance) & (self.conductance > 0)))[0])
            raise InputError(
                f"resistor {bad} between nodes {self.resistor_nodes[bad].tolist()} has conductance "
                f"{self.conductance[bad]}; it must be positive and finite (a short is a 0 V source)"
            )
        if np.any(self.capacitance < 0):
            bad = int(np.argmin(self.capacitance))
            raise InputError(
                f"capacitor {bad} between nodes {self.capacitor_nodes[bad].tolist()} has capacitance "
                f"{self.capacitance[bad]} F; it must be finite and not negative"
            )
        for name, unit in (("nonlinear_current", "amperes"), ("nonlinear_voltage", "volts")):
            if not np.all(getattr(self, name) > 0):
                bad = int(np.argmin(getattr(self, name) > 0))
                raise InputError(
                    f"nonlinear resistor {bad} between nodes {self.nonlinear_nodes[bad].tolist()} has {name} = "
                    f"{getattr(self, name)[bad]} {unit}; it must be positive"
                )
        check_element_names(self)
        if not isinstance(self.cell_map, CellMap | None):
            raise InputError(
                f"cell_map = {self.cell_map!r} must be a CellMap (of a netlist from compile_space), or None"
            )
        found = self.lattice_map
        if not isinstance(found, LatticeMap | None) or (found and len(found.resistor_site) != len(self.conductance)):
            raise InputError(
                f"lattice_map = {found!r} must be the LatticeMap of a netlist from compile_space with as many "
                "resistors, or None"
            )
        check_node_names(self.node_names, self.node_count)

    def _check_kind(self, kind: str, names: tuple[str, ...]) -> None:
        """Raise InputError unless the arrays of one kind of element have equal lengths and finite values.

        `names`: names of the arrays, first the array of node pairs; `kind`: kind, such as ``"resistor"``, for the
        message.  Values of ``conductance`` are not checked here.
        """
        nodes = getattr(self, names[0])
        for name in names[1:]:
            value = getattr(self, name)
            if value is not None and len(value) != len(nodes):
                raise InputError(
                    f"{name} has {len(value)} entries for {len(nodes)} pairs in {names[0]}; make them equal"
                )
            if value is not None and name != "conductance" and not all_within(value, -np.inf, np.inf):
                raise InputError(
                    f"{name} of {kind} {int(np.argmin(np.isfinite(value)))} is not finite; give a finite number"
                )

    def __repr__(self) -> str:
        counts = ((len(getattr(self, nodes)), kind) for kind, (nodes, *_) in ARRAYS.items())
        parts = ", ".join(f"{count:,} {kind}{'s' if count > 1 else ''}" for count, kind in counts if count)
        return f"<Netlist of {self.node_count:,} nodes: {parts or 'no elements'}>"

    @property
    def space_map(self) -> CellMap | LatticeMap | None:
        """Map from nodes to the cells, or to the sites of a lattice, of the compiled space; None without a space."""
        return self.lattice_map if self.cell_map is None else self.cell_map

    @property
    def cells(self) -> CellMap:
        """Map between the nodes and the cells of the compiled space.

        Raises
        ------
        InputError
            If the netlist was not compiled from a space, or with another lattice than "square".
        """
        if self.lattice_map is not None:
            raise InputError(
                f"this netlist has the lattice {self.lattice_map.wiring.lattice!r}, and its resistors do not cross "
                "faces of cells, as is needed here; compile the space with lattice = 'square' (or read the field of "
                "this lattice by rg.planning.lattice_field)"
            )
        if self.cell_map is None:
            raise InputError(
                "this netlist was not compiled from a space, so that its nodes have no cells; use compile_space(space)"
            )
        return self.cell_map

    def node_name(self, node: int) -> str:
        """Return the name of a node: ``0`` (ground), ``n_12_7`` (cell (12, 7)), ``obstacle``, ``goal_0`` or ``node_5``.

        Nodes of rails with one node per cell have the cell added: ``obstacle_3_4``, and ``goal_0_3_4`` for goal region
        0 at cell (3, 4).  Names read from a file have precedence.
        """
        check_whole("node", node, 0)
        return self.names_of(np.array([node]))[0]

    def names_of(self, nodes: ArrayLike) -> list[str]:
        """Return the names of several nodes.

        Parameters
        ----------
        nodes : array_like of int, shape (n,)
            Node numbers.

        Returns
        -------
        list of str, one per node

        Raises
        ------
        InputError
            If a node does not exist.
        """
        wanted = node_numbers("nodes", nodes, self.node_count, 0).astype(np.int64)
        if self.node_names is not None:
            return [self.node_names[node] for node in wanted.tolist()]
        if self.space_map is None:
            return ["0" if node == GROUND else f"node_{node}" for node in wanted.tolist()]
        return self.space_map.names(wanted)

    def cell_of_node(self) -> NDArray[np.int64]:
        """Return the flat index (C order) of the cell of every node, -1 for rails and ground; shape (node_count,).

        On a lattice this is the cell that contains the node's site.

        Raises
        ------
        InputError
            If the netlist was not compiled from a space.
        """
        found = self.space_map
        return (self.cells if found is None else found).cell_of_node(self.node_count)

    def to_networkx(self) -> nx.MultiGraph[int]:
        """Return the circuit as a multigraph.

        Returns
        -------
        networkx.MultiGraph
            Graph nodes are node numbers with the attribute ``name``.  Every edge has ``kind`` (``"resistor"``,
            ``"voltage source"``, ``"current source"``, ``"capacitor"``, ``"nonlinear resistor"``).  In this order, the
            values, in SI units, are ``conductance``; ``volts``; ``amps``; ``capacitance``; ``current`` and ``voltage``,
            the ``I0`` and ``V0`` of ``I0 tanh((V_a - V_b) / V0)``.  Resistors have ``tc1`` and ``tc2``, and all
            elements ``name``, if the netlist has them.  ``nodes`` is the ordered pair of nodes, ``number`` the index
            of the element within its kind.
        """
        return graph_of(self)

    @staticmethod
    def from_networkx(graph: nx.Graph[Any], ground: object = GROUND) -> Netlist:
        """Create a netlist from a graph with the attributes that `to_networkx` writes.

        Parameters
        ----------
        graph : networkx.Graph or MultiGraph
            Every edge is an element of the kind that its attribute ``kind`` names; without ``kind`` it is a resistor.
            Edges need values in SI units: ``conductance`` or ``resistance`` (resistor), ``volts`` (voltage source),
            ``amps`` (current source), ``capacitance`` (capacitor), ``current`` and ``voltage`` (nonlinear resistor).  A
            directed graph must not have resistors in both directions between two nodes.
        ground : hashable
            The graph node that becomes node 0; it is added if the graph does not contain it.

        Returns
        -------
        Netlist
            Nodes in the order of the graph, ground first.  Node names are the attributes ``name``, or else the graph
            nodes as strings; a duplicate name gets a suffix, such as ``a_2``.  Ground without a name is ``0``, or
            ``ground`` if another node is called ``0``.  Elements are in the order of their ``number``, or of the graph.

        Raises
        ------
        InputError
            If an edge has no value, a value that is not a finite number, or an unknown kind.
        """
        if not hasattr(graph, "is_directed"):
            raise InputError(f"graph = {graph!r} must be a graph of networkx, such as networkx.MultiGraph()")
        return Netlist(**fields_of(graph, ground))

    def replace(self, **changes: Any) -> Netlist:
        """Return a copy with changed fields; keywords are fields of `Netlist`; raise InputError for other names."""
        known = {item.name for item in fields(self)}
        if changes.keys() - known:
            raise InputError(f"a netlist has no field {sorted(changes.keys() - known)}; it has {sorted(known)}")
        return replace(self, **changes)


def add_elements(
    netlist: Netlist, kind: str, nodes: ArrayLike, *values: ArrayLike, face: ArrayLike = -1, upward: ArrayLike = True
) -> Netlist:
    """Return a netlist with n appended elements of one kind, and without element names.

    `kind`: kind of the elements, such as ``"resistor"``; `nodes` (n, 2): nodes of the elements; `values`, each (n,) or
    (): values of the elements in SI units.  Their order is conductance, tc1, tc2 for resistors, ``I0`` and ``V0`` of
    ``I0 tanh(V / V0)`` for nonlinear resistors; other kinds have one value.  Missing values are 0; tc1 and tc2 are
    ignored if the netlist has none.  `face`, `upward`, each (n,) or (): for the cell map, number of the cell face that
    every element crosses, -1 for none, and whether the first node of the element is on the lower side of this face.
    Faces are numbered axis by axis, in C order of arrays with one more face than cells along the axis.
    """
    _require_no_lattice(netlist)
    pairs, *names = ARRAYS[kind]
    added = np.reshape(nodes, (-1, 2))

    def appended(old: NDArray[Any], new: ArrayLike) -> NDArray[Any]:
        return np.append(old, np.broadcast_to(new, len(added)))

    changes: dict[str, Any] = {pairs: np.concatenate([getattr(netlist, pairs), added])}
    left_out = [0.0] * (len(names) - len(values))
    for name, value in zip(names, [*values, *left_out], strict=True):
        if getattr(netlist, name) is not None:
            changes[name] = appended(getattr(netlist, name), value)
    if netlist.cell_map is not None and kind in _FACES:
        crossed = zip(_FACES[kind], (face, upward), strict=True)
        columns: dict[str, Any] = {name: appended(getattr(netlist.cell_map, name), new) for name, new in crossed}
        changes["cell_map"] = replace(netlist.cell_map, **columns)
    return netlist.replace(element_names=None, **changes)


def crossed_by(netlist: Netlist, kind: str, which: NDArray[np.bool_] | slice = slice(None)) -> dict[str, NDArray[Any]]:
    """Return a dictionary with the cell faces that some resistors cross; empty for a netlist without a cell map.

    Keys, which are keywords of `add_elements`: ``"face"``, number of the face that every resistor crosses, -1 for none;
    ``"upward"``, whether the first node of the resistor is on the lower side of the face.  `kind`: ``"resistor"`` or
    ``"nonlinear resistor"``; `which`: mask or slice of the resistors of this kind, by default all.
    """
    if netlist.cell_map is None:
        return {}
    return {
        key: getattr(netlist.cell_map, name)[which] for key, name in zip(("face", "upward"), _FACES[kind], strict=True)
    }


def select_elements(netlist: Netlist, kind: str, keep: NDArray[np.bool_]) -> Netlist:
    """Return a netlist without the elements of a kind for which `keep` (elements,) is False.

    The names of all elements are removed.  `kind`: kind of the elements, such as ``"resistor"``.
    """
    _require_no_lattice(netlist)
    columns = {name: getattr(netlist, name) for name in ARRAYS[kind]}
    changes: dict[str, Any] = {name: column[keep] for name, column in columns.items() if column is not None}
    if netlist.cell_map is not None and kind in _FACES:
        faces = {name: getattr(netlist.cell_map, name)[keep] for name in _FACES[kind]}
        changes["cell_map"] = replace(netlist.cell_map, **faces)
    return netlist.replace(element_names=None, **changes)


def _require_no_lattice(netlist: Netlist) -> None:
    """Raise InputError if the netlist has another lattice than "square": a change would invalidate its lattice map."""
    if netlist.lattice_map is not None:
        require_square(netlist.lattice_map.wiring.lattice, "a change of the elements of a compiled netlist")
