"""Netlists in files that are no decks: what is written is read as it was.

Tests internals: `resgrid.io.networks`.
"""

from __future__ import annotations

from io import StringIO
from pathlib import Path

import networkx as nx
import numpy as np
import pytest
from support.circuits import random_grid

import resgrid as rg
from resgrid.io.networks import NETWORK_SUFFIXES

ARRAYS = ("resistor_nodes", "conductance", "tc1", "tc2", "source_nodes", "source_volts", "current_nodes",
          "current_amps", "capacitor_nodes", "capacitance", "nonlinear_nodes", "nonlinear_current",
          "nonlinear_voltage")  # fmt: skip


def everything(seed: int) -> rg.Netlist:
    """Every kind of element, in an order of its own, with names and odd numbers."""
    rng = np.random.default_rng(seed)

    def pairs(count: int) -> np.ndarray:
        return rng.integers(0, 9, (count, 2))

    def values(count: int) -> np.ndarray:
        return 10.0 ** rng.uniform(-12, 12, count)

    named = seed % 2 == 1
    kinds = {"resistor": 20, "voltage source": 3, "current source": 4, "capacitor": 2}
    return rg.Netlist(
        9, pairs(20), values(20), pairs(3), -values(3), pairs(4), values(4), pairs(2), values(2),
        tc1=values(20) if seed % 2 else None, tc2=values(20) if seed % 3 else None,
        nonlinear_nodes=pairs(2), nonlinear_current=values(2), nonlinear_voltage=values(2),
        node_names=("0", "a", "X1.mid", "n_3_7", "1.0", "β", "/net-1", "Net-(R1)", "b") if named else None,
        element_names={kind: tuple(f"{kind}.{i}é" for i in range(n)) for kind, n in kinds.items()} if named else None,
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("suffix", [".graphml", ".json", ".npz"])
def test_a_netlist_is_read_as_it_was_written(tmp_path: Path, suffix: str, seed: int) -> None:
    netlist = everything(seed)
    rg.save(netlist, tmp_path / f"a{suffix}")
    back = rg.read_spice(tmp_path / f"a{suffix}").netlist()
    for name in ARRAYS:
        mine, read = getattr(netlist, name), getattr(back, name)
        assert (mine is None) == (read is None), name
        assert mine is None or (np.array_equal(mine, read) and mine.dtype == read.dtype), name
    everyone = range(netlist.node_count)
    assert back.names_of(everyone) == netlist.names_of(everyone)
    assert dict(back.element_names or {}) == dict(netlist.element_names or {})
    rg.save(back, tmp_path / f"b{suffix}")
    assert rg.read_spice(tmp_path / f"b{suffix}").netlist().conductance.tolist() == netlist.conductance.tolist()


@pytest.mark.parametrize("seed", range(4))
def test_an_edge_list_keeps_resistors_and_ground(tmp_path: Path, seed: int) -> None:
    grid = random_grid(seed)
    rg.save(grid, tmp_path / "a.txt")
    back = rg.read_spice(tmp_path / "a.txt").netlist()
    ours, read = ([[n.names_of(pair) for pair in n.resistor_nodes], n.conductance] for n in (grid, back))
    assert [["ground" if name == "0" else name for name in pair] for pair in ours[0]] == read[0]
    assert read[1] == pytest.approx(ours[1], rel=1e-15)
    assert set(back.resistor_nodes[:, 1]) >= {0} or 0 not in grid.resistor_nodes


@pytest.mark.parametrize("name", ["ground", "a b", "a,b", "#1", "1.0", ""])
def test_names_that_an_edge_list_cannot_hold_are_refused(tmp_path: Path, name: str) -> None:
    netlist = rg.Netlist(3, [[1, 2], [2, 0]], [1.0, 1.0], node_names=("0", name, "b"))
    with pytest.raises(rg.InputError, match="edge list cannot hold"):
        rg.save(netlist, tmp_path / "a.txt")
    assert list(tmp_path.iterdir()) == []


def test_graphs_of_others_are_read(tmp_path: Path) -> None:
    graph = nx.Graph()
    graph.add_edge("in", "out", resistance=2.0)
    graph.add_edge("out", "0", conductance=0.25)
    graph.add_edge("in", "0", kind="voltage source", volts=3.0, nodes="in 0")
    nx.write_graphml(graph, tmp_path / "a.graphml")
    netlist = rg.read_spice(tmp_path / "a.graphml").netlist()
    volts = dict(zip(netlist.node_names, rg.solve(netlist).voltage.tolist(), strict=True))
    assert volts == pytest.approx({"0": 0.0, "in": 3.0, "out": 2.0})


@pytest.mark.parametrize("suffix", [*NETWORK_SUFFIXES, ".ini"])
@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"\x00\xff", b"<graphml/>", b'{"nodes": [], "edges": 3}', b"PK"])
def test_a_damaged_file_is_one_message(tmp_path: Path, suffix: str, content: bytes) -> None:
    file = tmp_path / f"a{suffix}"
    file.write_bytes(content)
    try:
        rg.read_spice(file).netlist()
    except rg.InputError as error:
        assert file.name in str(error)
    with pytest.raises(rg.InputError):
        rg.read_spice(tmp_path / f"absent{suffix}").netlist()


def test_unknown_ends_are_refused(tmp_path: Path) -> None:
    with pytest.raises(rg.InputError, match="its name must end in"):
        rg.save(everything(0), tmp_path / "a.xyz")


def ring_with_ground_1() -> nx.MultiGraph:
    ring = nx.MultiGraph([(0, 1), (1, 2), (0, 2)])
    nx.set_edge_attributes(ring, 1.0, "resistance")
    ring.add_edge(1, 0, kind="current source", amps=1.0, nodes=(1, 0))
    return ring


@pytest.mark.parametrize("suffix", [".graphml", ".json", ".npz", ".txt"])
def test_every_node_of_a_graph_has_a_name_of_its_own(tmp_path: Path, suffix: str) -> None:
    netlist = rg.Netlist.from_networkx(ring_with_ground_1(), ground=1)
    assert netlist.node_names == ("ground", "0", "2")
    op = rg.solve(netlist)
    rg.save(op, tmp_path / "a.csv")
    lines = [line.split(",") for line in (tmp_path / "a.csv").read_text().splitlines()]
    volts = {line[1]: float(line[5]) for line in lines if line[0] == "node"}
    assert volts == pytest.approx({"ground": 0.0, "0": 2 / 3, "2": 1 / 3})
    rg.save(netlist, tmp_path / f"a{suffix}")
    assert rg.read_spice(tmp_path / f"a{suffix}").node_names == netlist.node_names


def test_names_that_are_taken_get_a_suffix() -> None:
    graph = nx.Graph([(1, "1"), ("1", 0), (1, "1_2")])
    nx.set_edge_attributes(graph, 2.0, "resistance")
    assert rg.Netlist.from_networkx(graph).node_names == ("0", "1", "1_3", "1_2")
    with pytest.raises(rg.InputError, match="2 nodes have the name 'a'"):
        rg.Netlist(3, [[1, 2]], [1.0], node_names=("0", "a", "a"))


@pytest.mark.parametrize(
    ("attributes", "message"),
    [
        ({"resistance": "3k"}, "resistance = '3k'"),
        ({"resistance": None}, "no 'conductance' or 'resistance'"),
        ({"weight": 3.0}, "no 'conductance' or 'resistance'"),
        ({"resistance": float("nan")}, "finite number"),
        ({"resistance": -1.0}, "must be positive"),
        ({"resistance": 0}, "source of 0 V"),
        ({"conductance": 0.0}, "must be positive"),
        ({"conductance": 1.0, "resistance": 3.0}, "contradict"),
        ({"resistance": True}, "finite number"),
        ({"kind": "voltage source", "volts": "5v"}, "volts = '5v'"),
        ({"kind": "voltage source", "volts": 5.0, "nodes": (7, 8)}, "must be its two nodes"),
        ({"kind": ["resistor"], "resistance": 1.0}, "has kind"),
        ({"resistance": 1.0, "number": "first"}, "number = 'first'"),
    ],
)
def test_edges_that_are_refused_are_named(attributes: dict[str, object], message: str) -> None:
    graph = nx.Graph()
    graph.add_edge("in", "out", **attributes)
    with pytest.raises(rg.InputError, match="edge 'in' - 'out' .*" + message):
        rg.Netlist.from_networkx(graph, "out")


def test_directed_graphs() -> None:
    graph = nx.DiGraph()
    graph.add_edge("a", 0, resistance="2.0")
    assert rg.Netlist.from_networkx(graph).conductance.tolist() == [0.5]
    graph.add_edge(0, "a", resistance=2.0)
    with pytest.raises(rg.InputError, match="one resistor, or two"):
        rg.Netlist.from_networkx(graph)
    assert len(rg.Netlist.from_networkx(graph.to_undirected()).conductance) == 1
    with pytest.raises(rg.InputError, match="graph of networkx"):
        rg.Netlist.from_networkx([("a", "b")])  # type: ignore[arg-type]


def test_names_are_looked_up_by_any_sequence_of_numbers() -> None:
    deck = rg.read_spice(StringIO("title\nR1 a b 1\nR2 b 0 1\n"))
    assert deck.names_of(range(3)) == deck.names_of([0, 1, 2]) == ["0", "a", "b"]
