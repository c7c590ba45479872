from collections.abc import Callable

import networkx as nx
import numpy as np
import pytest
from support.spaces import space_of

import resgrid as rg


def ladder() -> rg.Netlist:
    return rg.Netlist(
        3,
        np.array([[1, 2], [2, 0]]),
        np.array([1.0, 0.5]),
        source_nodes=np.array([[1, 0]]),
        source_volts=np.array([3.0]),
        current_nodes=np.array([[0, 2]]),
        current_amps=np.array([1.0]),
        capacitor_nodes=np.array([[2, 0]]),
        capacitance=np.array([1e-12]),
        nonlinear_nodes=np.array([[2, 1]]),
        nonlinear_current=np.array([1e-9]),
        nonlinear_voltage=np.array([0.1]),
    )


def test_a_graph_goes_there_and_back() -> None:
    netlist = ladder()
    back = rg.Netlist.from_networkx(netlist.to_networkx())
    for nodes, value in (
        ("resistor_nodes", "conductance"),
        ("source_nodes", "source_volts"),
        ("current_nodes", "current_amps"),
        ("capacitor_nodes", "capacitance"),
        ("nonlinear_nodes", "nonlinear_current"),
        ("nonlinear_nodes", "nonlinear_voltage"),
    ):
        sides = [
            sorted(zip(getattr(side, nodes).tolist(), getattr(side, value).tolist(), strict=True))
            for side in (netlist, back)
        ]
        assert sides[0] == sides[1], nodes


def test_a_plain_graph_becomes_resistors() -> None:
    graph = nx.Graph()
    graph.add_edge("a", "b", resistance=2.0)
    graph.add_edge("b", "gnd", conductance=3.0)
    netlist = rg.Netlist.from_networkx(graph, ground="gnd")
    assert netlist.conductance.tolist() == [0.5, 3.0]
    assert netlist.names_of([0, 1, 2]) == ["0", "a", "b"]


@pytest.mark.parametrize(
    "changes",
    [
        {"conductance": np.array([1.0, 0.0])},
        {"conductance": np.array([1.0, np.inf])},
        {"conductance": np.array([1.0])},
        {"resistor_nodes": np.array([[0, 3], [0, 1]])},
        {"resistor_nodes": np.array([[0.5, 1], [0, 1]])},
        {"source_volts": np.array([np.nan])},
        {"node_names": ("0", "a")},
        {"nonlinear_current": np.array([0.0])},
        {"nonlinear_current": np.array([np.inf])},
        {"nonlinear_voltage": np.array([-1.0])},
        {"nonlinear_nodes": np.array([[2, 3]])},
        {"conductance": None},
        {"conductance": np.array([1.0, 1.0j])},
        {"conductance": ["1k", "2k"]},
        {"resistor_nodes": [1, [2]]},
        {"source_volts": np.array([1.0 + 1.0j])},
        {"nonlinear_current": None},
        {"node_names": 3},
        {"colour": 1},
    ],
)
def test_wrong_values_are_refused(changes: dict[str, object]) -> None:
    with pytest.raises(rg.InputError):
        ladder().replace(**changes)


def test_edges_without_a_value_or_of_no_known_kind_are_refused() -> None:
    graph = nx.Graph([(0, 1)])
    with pytest.raises(rg.InputError, match="conductance"):
        rg.Netlist.from_networkx(graph)
    graph.edges[0, 1]["kind"] = "diode"
    with pytest.raises(rg.InputError, match="diode"):
        rg.Netlist.from_networkx(graph)


def test_names_come_from_cells() -> None:
    cell = np.zeros((3, 2))
    cell[1, 1], cell[2, 0] = 2, 1
    netlist = rg.compile_space(space_of(cell))
    names = netlist.names_of(np.arange(netlist.node_count))
    assert names == ["0", "obstacle", "goal_0", "n_0_0", "n_0_1", "n_1_0", "n_2_1"]
    assert netlist.cell_of_node().tolist() == [-1, -1, -1, 0, 1, 2, 5]


@pytest.mark.parametrize("node", [-1, 3, 2**32 + 1, 2**63])
def test_a_node_that_does_not_exist_is_refused_however_large(node: int) -> None:
    with pytest.raises(rg.InputError, match=r"resistor_nodes names a node outside 0 \.\.\. 2"):
        ladder().replace(resistor_nodes=np.array([[1, 2], [2, node]], dtype=np.uint64 if node > 3 else np.int64))


def test_more_nodes_than_32_bits_number_are_refused() -> None:
    with pytest.raises(rg.InputError, match=r"node_count = 2147483648 must be a whole number from 1 to 2,147,483,647"):
        ladder().replace(node_count=2**31)


def test_nodes_of_any_width_are_kept_in_32_bits() -> None:
    netlist = ladder().replace(resistor_nodes=np.array([[1, 2], [2, 0]], dtype=np.uint8))
    assert netlist.resistor_nodes.dtype == netlist.source_nodes.dtype == np.int32
    assert netlist.resistor_nodes.tolist() == [[1, 2], [2, 0]]


def test_a_netlist_is_not_changed_through_the_arrays_that_it_was_made_from() -> None:
    pairs, conductance, volts = np.array([[1, 2], [2, 0]], dtype=np.int32), np.array([1.0, 2.0]), np.array([3.0])
    netlist = rg.Netlist(3, pairs, conductance, source_nodes=[[1, 0]], source_volts=volts)
    pairs[:], conductance[:], volts[:] = 0, -1.0, np.nan
    assert netlist.resistor_nodes.tolist() == [[1, 2], [2, 0]]
    assert netlist.conductance.tolist() == [1.0, 2.0] and netlist.source_volts.tolist() == [3.0]
    shared = netlist.replace(source_volts=[4.0])
    assert np.shares_memory(shared.conductance, netlist.conductance)  # nobody can write there


def test_masked_numbers_are_refused() -> None:
    with pytest.raises(rg.InputError, match="none masked"):
        rg.Netlist(3, [[1, 2], [2, 0]], np.ma.masked_equal([1e-3, -1.0], -1.0))


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (lambda netlist: netlist.replace(cell_map=3), "cell_map = 3 must be a CellMap"),
        (lambda netlist: netlist.node_name("a"), "node = 'a' must be a whole number"),
        (lambda netlist: netlist.node_name(-1), "node = -1 must be a whole number"),
        (lambda netlist: netlist.node_name([]), r"node = \[\] must be a whole number"),
        (lambda netlist: netlist.replace(element_names=3), "element_names = 3 must map kinds of elements to strings"),
        (lambda netlist: netlist.replace(element_names={"diode": ()}), "must map kinds of elements to strings"),
        (
            lambda netlist: netlist.replace(element_names={"resistor": ("a",)}),
            "must be 2 strings, one for every resistor",
        ),
        (lambda netlist: netlist.names_of([0, 3]), "nodes names a node outside 0 ... 2"),
        (lambda netlist: netlist.names_of([0.5]), "nodes must hold node numbers"),
        (lambda netlist: netlist.names_of([[1]]), r"nodes has shape \(1, 1\)"),
        (lambda netlist: rg.solve(netlist).is_of(3), "netlist is of type int; give a Netlist"),
    ],
)
def test_questions_that_make_no_sense_are_refused(ask: Callable[[rg.Netlist], object], message: str) -> None:
    with pytest.raises(rg.InputError, match=message):
        ask(rg.Netlist(3, [[1, 2], [2, 0]], [1.0, 1.0], source_nodes=[[1, 0]], source_volts=[1.0]))
