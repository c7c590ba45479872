from pathlib import Path

import networkx as nx
import numpy as np
import pytest

from resgrid import Netlist, read_spice, solve
from resgrid.errors import InputError
from resgrid.spice.networks.circuitscape import read_circuitscape


def voltages(netlist: Netlist) -> dict[str, float]:
    assert netlist.node_names is not None
    return dict(zip(netlist.node_names, solve(netlist).voltage.tolist(), strict=True))


def test_edge_lists(tmp_path: Path) -> None:
    graph = nx.random_regular_graph(3, 20, seed=3)
    weight = {edge: 1.0 + i for i, edge in enumerate(graph.edges)}
    (tmp_path / "net.csv").write_text(
        "# a network\nfrom,to,conductance\n" + "".join(f"v{a},v{b},{w}\n" for (a, b), w in weight.items())
    )
    (tmp_path / "in.txt").write_text("v3 1\n")
    (tmp_path / "out.txt").write_text("v7 0\n")
    netlist = read_spice(tmp_path / "net.csv", sources=tmp_path / "in.txt", grounds=tmp_path / "out.txt").netlist()
    nx.set_edge_attributes(graph, weight, "g")
    expected = nx.resistance_distance(graph, 3, 7, weight="g", invert_weight=False)
    assert voltages(netlist)["v3"] == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a b 1\na b\n", ":2: a edge is 2"),
        ("a b 1\na b wat\n", ":2"),
        ("a b -1\n", "not admissible"),
        ("a b 0\n", "must be positive"),
        ("a b nan\n", "finite"),
        ("a b 1\x00", "zero byte"),
    ],
)
def test_edge_lists_that_are_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "net.csv").write_text(text)
    with pytest.raises(InputError, match=r"net\.csv") as caught:
        read_spice(tmp_path / "net.csv")
    assert message.replace("a edge", "an edge") in str(caught.value).replace("a edge", "an edge")


def test_nodes_must_be_on_an_edge(tmp_path: Path) -> None:
    (tmp_path / "net.txt").write_text("1.000 2.000 5\n")
    (tmp_path / "in.txt").write_text("3 1\n")
    with pytest.raises(InputError, match=r"in.txt:1: the node '3' is on no edge"):
        read_spice(tmp_path / "net.txt", sources=tmp_path / "in.txt")


def make_raster(folder: Path, name: str, rows: list[str]) -> None:
    head = (
        f"ncols {len(rows[0].split())}\nnrows {len(rows)}\nxllcorner 0\nyllcorner 0\ncellsize 1\nNODATA_value -9999\n"
    )
    (folder / name).write_text(head + "\n".join(rows) + "\n")


def configuration(folder: Path, **changes: object) -> Path:
    values: dict[str, object] = {
        "data_type": "raster",
        "scenario": "advanced",
        "habitat_file": "elsewhere/cells.asc",
        "habitat_map_is_resistances": True,
        "source_file": "in.asc",
        "ground_file": "out.asc",
        "ground_file_is_resistances": True,
        "connect_four_neighbors_only": True,
        "connect_using_avg_resistances": True,
        "remove_src_or_gnd": "keepall",
        **changes,
    }
    path = folder / "case.ini"
    path.write_text("[all]\n" + "".join(f"{key} = {value}\n" for key, value in values.items()))
    return path


def test_rasters_by_hand(tmp_path: Path) -> None:
    make_raster(tmp_path, "cells.asc", ["1 3 -9999", "-9999 5 1"])
    make_raster(tmp_path, "in.asc", ["2 -9999 -9999", "-9999 -9999 -9999"])
    make_raster(tmp_path, "out.asc", ["-9999 -9999 -9999", "-9999 -9999 0"])
    make_raster(tmp_path, "same.asc", ["-9999 4 -9999", "-9999 4 -9999"])
    assert voltages(read_spice(configuration(tmp_path)).netlist())["r0_c0"] == pytest.approx(2 * (2 + 4 + 3))
    merged, node = read_circuitscape(configuration(tmp_path, use_polygons=True, polygon_file="same.asc"))
    assert voltages(merged.netlist())["r0_c0"] == pytest.approx(2 * (2 + 3))
    assert node is not None
    assert node[0, 1] == node[1, 1]
    conducting = configuration(tmp_path, habitat_map_is_resistances=False, connect_using_avg_resistances=False)
    assert voltages(read_spice(conducting).netlist())["r0_c0"] == pytest.approx(2 * (1 / 2 + 1 / 4 + 1 / 3))
    diagonal = voltages(read_spice(configuration(tmp_path, connect_four_neighbors_only=False)).netlist())
    root = np.sqrt(2)
    way_b = 1 / (1 / 4 + 0)  # r0_c1 to r1_c1 by its face
    assert diagonal["r0_c0"] == pytest.approx(_diagonal_answer(root, way_b))


def _diagonal_answer(root: float, between: float) -> float:
    """Four nodes solved densely: faces of 2, 4 and 3 ohm, diagonals of 3 and 2 ohm times sqrt(2)."""
    edges = [(0, 1, 2.0), (1, 2, between), (2, 3, 3.0), (0, 2, 3.0 * root), (1, 3, 2.0 * root)]
    G = np.zeros((4, 4))
    for a, b, r in edges:
        G[[a, b], [a, b]] += 1 / r
        G[[a, b], [b, a]] -= 1 / r
    return float(np.linalg.solve(G[:3, :3], [2.0, 0, 0])[0])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"scenario": "pairwise"}, "advanced"),
        ({"habitat_file": "../cells.asc"}, ""),
        ({"source_file": "absent.asc"}, "source_file"),
        ({"connect_four_neighbors_only": "perhaps"}, "neither True nor False"),
        ({"remove_src_or_gnd": "both"}, "keepall"),
        ({"use_mask": True}, "use_mask"),
        ({"data_type": "vector"}, "data_type"),
        ({"ground_file": "short.asc"}, "cells"),
    ],
)
def test_configurations_that_are_refused(tmp_path: Path, change: dict[str, object], message: str) -> None:
    make_raster(tmp_path, "cells.asc", ["1 3", "2 5"])
    make_raster(tmp_path, "in.asc", ["2 -9999", "-9999 -9999"])
    make_raster(tmp_path, "out.asc", ["-9999 -9999", "-9999 0"])
    make_raster(tmp_path, "short.asc", ["1 1"])
    path = configuration(tmp_path, **change)
    if not message:
        assert len(read_spice(path).resistance) == 4
        return
    with pytest.raises(InputError, match=message):
        read_spice(path)


@pytest.mark.parametrize(
    ("content", "kind"), [(b"II*\0\x08\0\0\0", "GeoTIFF"), (b"1\t10.5\t20.5\n2\t11.5\t20.5\n", "list of points")]
)
def test_maps_in_other_formats_are_named(tmp_path: Path, content: bytes, kind: str) -> None:
    make_raster(tmp_path, "cells.asc", ["1 3", "2 5"])
    make_raster(tmp_path, "out.asc", ["-9999 -9999", "-9999 0"])
    (tmp_path / "in.asc").write_bytes(content)
    with pytest.raises(InputError, match=kind):
        read_spice(configuration(tmp_path))
