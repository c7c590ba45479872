"""Edge lists and Circuitscape jobs, compared with networkx, dense solutions and values computed by hand.

Tests internals: `resgrid.spice.networks.circuitscape`.
"""

import json
from pathlib import Path

import networkx as nx
import numpy as np
import pytest

import resgrid as rg
from resgrid.spice.networks.circuitscape import read_circuitscape


def voltages(netlist: rg.Netlist) -> dict[str, float]:
    assert netlist.node_names is not None
    return dict(zip(netlist.node_names, rg.solve(netlist).voltage.tolist(), strict=True))


def test_an_edge_list_agrees_with_networkx_resistance_distance(tmp_path: Path) -> None:
    graph = nx.random_regular_graph(3, 20, seed=3)
    weight = {edge: 1.0 + i for i, edge in enumerate(graph.edges)}
    (tmp_path / "net.csv").write_text(
        "# a network\nfrom,to,conductance\n" + "".join(f"v{a},v{b},{w}\n" for (a, b), w in weight.items())
    )
    (tmp_path / "in.txt").write_text("v3 1\n")
    (tmp_path / "out.txt").write_text("v7 0\n")
    netlist = rg.read_spice(tmp_path / "net.csv", sources=tmp_path / "in.txt", grounds=tmp_path / "out.txt").netlist()
    nx.set_edge_attributes(graph, weight, "g")
    expected = nx.resistance_distance(graph, 3, 7, weight="g", invert_weight=False)
    assert voltages(netlist)["v3"] == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a b 1\na b\n", ":2: 'a b' is not an edge"),
        ("a,b,1k\nb,c,2\n", ":1: 'a,b,1k' is not an edge"),
        ("a b 1_000\n", "is not an edge"),
        ("a b 1e-320\n", "inverse overflows"),
        ("%%MatrixMarket matrix\n2 2 1\n", "Matrix Market"),
        ("a b 1\na b wat\n", ":2"),
        ("a b -1\n", "not admissible"),
        ("a b 0\n", "must be positive"),
        ("a b nan\n", "finite"),
        ("a b 1\x00", "zero byte"),
    ],
)
def test_invalid_edge_lists_raise_input_error(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "net.csv").write_text(text)
    with pytest.raises(rg.InputError, match=r"net\.csv") as caught:
        rg.read_spice(tmp_path / "net.csv")
    assert message in str(caught.value)


def test_sources_at_unknown_nodes_raise_input_error(tmp_path: Path) -> None:
    (tmp_path / "net.txt").write_text("1.000 2.000 5\n")
    (tmp_path / "in.txt").write_text("3 1\n")
    with pytest.raises(rg.InputError, match=r"in.txt:1: the node '3' is on no edge"):
        rg.read_spice(tmp_path / "net.txt", sources=tmp_path / "in.txt")


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


def test_rasters_agree_with_values_computed_by_hand(tmp_path: Path) -> None:
    make_raster(tmp_path, "cells.asc", ["1 3 -9999", "-9999 5 1"])
    make_raster(tmp_path, "in.asc", ["2 -9999 -9999", "-9999 -9999 -9999"])
    make_raster(tmp_path, "out.asc", ["-9999 -9999 -9999", "-9999 -9999 0"])
    make_raster(tmp_path, "same.asc", ["-9999 4 -9999", "-9999 4 -9999"])
    assert voltages(rg.read_spice(configuration(tmp_path)).netlist())["r0_c0"] == pytest.approx(2 * (2 + 4 + 3))
    merged, node = read_circuitscape(configuration(tmp_path, use_polygons=True, polygon_file="same.asc"))
    assert voltages(merged.netlist())["r0_c0"] == pytest.approx(2 * (2 + 3))
    assert node is not None
    assert node[0, 1] == node[1, 1]
    conducting = configuration(tmp_path, habitat_map_is_resistances=False, connect_using_avg_resistances=False)
    assert voltages(rg.read_spice(conducting).netlist())["r0_c0"] == pytest.approx(2 * (1 / 2 + 1 / 4 + 1 / 3))
    diagonal = voltages(rg.read_spice(configuration(tmp_path, connect_four_neighbors_only=False)).netlist())
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
        ({"use_mask": True}, "mask_file' is missing"),
        ({"use_mask": True, "mask_file": "none.asc"}, "removes all cells"),
        ({"use_reclass_table": True}, "use_reclass_table"),
        ({"use_polygons": True, "polygon_file": "half.asc"}, "whole number"),
        ({"use_direct_grounds": "TRUE"}, "only True, true and 1"),
        ({"use_polgons": True}, "did you mean 'use_polygons'"),
        ({"Use_Mask": True}, "write it 'use_mask'"),
        ({"  use_mask": True}, "write it 'use_mask'"),
        ({"ground_file": "(Browse for a ground point file)"}, "'ground_file' is missing"),
        ({"ground_file": "out.asc", "ground_file_is_resistances": False}, "none of the grounds"),
        ({"data_type": "vector"}, "data_type"),
        ({"ground_file": "short.asc"}, "cells"),
    ],
)
def test_invalid_configurations_raise_input_error(tmp_path: Path, change: dict[str, object], message: str) -> None:
    make_raster(tmp_path, "cells.asc", ["1 3", "2 5"])
    make_raster(tmp_path, "in.asc", ["2 -9999", "-9999 -9999"])
    make_raster(tmp_path, "out.asc", ["-9999 -9999", "-9999 0"])
    make_raster(tmp_path, "short.asc", ["1 1"])
    make_raster(tmp_path, "none.asc", ["0 -1", "-9999 0"])
    make_raster(tmp_path, "half.asc", ["0.5 0.5", "0 0"])
    path = configuration(tmp_path, **change)
    if not message:
        assert len(rg.read_spice(path).resistance) == 4
        return
    with pytest.raises(rg.InputError, match=message):
        rg.read_spice(path)


@pytest.mark.parametrize(
    ("content", "kind"), [(b"II*\0\x08\0\0\0", "GeoTIFF"), (b"1\t10.5\t20.5\n2\t11.5\t20.5\n", "list of points")]
)
def test_other_file_formats_are_named_in_the_error(tmp_path: Path, content: bytes, kind: str) -> None:
    make_raster(tmp_path, "cells.asc", ["1 3", "2 5"])
    make_raster(tmp_path, "out.asc", ["-9999 -9999", "-9999 0"])
    (tmp_path / "in.asc").write_bytes(content)
    with pytest.raises(rg.InputError, match=kind):
        rg.read_spice(configuration(tmp_path))


def job(folder: Path, **files_and_keys: object) -> np.ndarray:
    """Write a raster job and return the voltage of every cell, NaN without a node; lists of rows become files."""
    keys = {}
    for key, value in files_and_keys.items():
        if isinstance(value, list):
            make_raster(folder, f"{key}.asc", value)
            keys[f"{key}_file"] = f"{key}.asc"
        else:
            keys[key] = value
    text = "".join(f"{key} = {value}\n" for key, value in keys.items())
    (folder / "job.ini").write_text(f"[Circuitscape mode]\nscenario = advanced\n{text}")
    network, node = read_circuitscape(folder / "job.ini")
    assert node is not None
    return np.append(rg.solve(network.netlist()).voltage, np.nan)[node]


def test_absent_keys_have_the_defaults_of_circuitscape(tmp_path: Path) -> None:
    line = {"habitat": ["10 10 10"], "source": ["1 -9999 -9999"], "ground": ["-9999 -9999 4"]}
    assert job(tmp_path, **line)[0] == pytest.approx([24.0, 14.0, 4.0])
    (tmp_path / "e.txt").write_text("1 2 10\n2 3 10\n")
    (tmp_path / "s.txt").write_text("1 1\n")
    (tmp_path / "g.txt").write_text("3 4\n")
    keys = "data_type = network\nscenario = advanced\nhabitat_file = e.txt\nsource_file = s.txt\nground_file = g.txt\n"
    (tmp_path / "net.ini").write_text(keys)
    assert voltages(rg.read_spice(tmp_path / "net.ini").netlist()) == pytest.approx(
        {"ground": 0.0, "1": 24.0, "2": 14.0, "3": 4.0}
    )


@pytest.mark.parametrize(
    ("policy", "grounds", "expected"),
    [
        ("keepall", "-9999 -9999 0 0", [4.0, 3.0, 2.0, 0.0]),  # the positive source removes its direct ground
        ("rmvsrc", "-9999 -9999 0 0", [2.0, 1.0, 0.0, 0.0]),
        ("rmvgnd", "-9999 -9999 0 0", [4.0, 3.0, 2.0, 0.0]),
        ("rmvall", "-9999 -9999 0 0", [3.0, 2.0, 1.0, 0.0]),
        ("keepall", "-9999 -9999 2 0", [3.0 + 1 / 3, 2.0 + 1 / 3, 1.0 + 1 / 3, 0.0]),
        ("rmvgnd", "-9999 -9999 2 0", [4.0, 3.0, 2.0, 0.0]),
    ],
)
def test_sources_at_grounds_follow_the_removal_policy(
    tmp_path: Path, policy: str, grounds: str, expected: list[float]
) -> None:
    cells = {"habitat": ["1 1 1 1"], "source": ["1 -9999 1 -9999"], "ground": [grounds]}
    assert job(tmp_path, remove_src_or_gnd=policy, **cells)[0] == pytest.approx(expected)


def test_cell_values_are_replaced_before_polygons_merge_cells(tmp_path: Path) -> None:
    line = {"habitat": ["1 1 1 1"], "ground": ["-9999 -9999 -9999 0"], "source": ["5 7 -9999 -9999"]}
    polygons = {"use_polygons": True, "polygon": ["1 1 -9999 -9999"]}
    assert job(tmp_path, use_unit_currents=True, **line, **polygons)[0] == pytest.approx([4.0, 4.0, 2.0, 0.0])
    line["ground"] = ["-9999 -9999 3 9"]
    polygons["polygon"] = ["-9999 -9999 -2 -2"]  # any whole number but 0
    direct = job(tmp_path, use_direct_grounds=True, **line, **polygons)
    assert direct[0] == pytest.approx([17.0, 12.0, 0.0, 0.0])


def test_empty_cells_of_a_polygon_belong_to_its_node(tmp_path: Path) -> None:
    cells = {
        "habitat": ["1 -9999 2", "-9999 -9999 -9999"], "polygon": ["3 3 -9999", "-9999 3 -9999"],
        "source": ["-9999 -9999 1", "-9999 2 -9999"], "ground": ["0 -9999 -9999", "-9999 -9999 -9999"],
    }  # fmt: skip
    four = {"use_polygons": True, "connect_four_neighbors_only": True, "habitat_map_is_resistances": False}
    volts = job(tmp_path, remove_src_or_gnd="rmvsrc", **cells, **four)
    assert volts[0] == pytest.approx([0.0, 0.0, 1.0])  # (0 + 2)/2 S between the empty cell and its neighbour
    assert volts[1, 1] == 0.0
    assert np.isnan(volts[1, 0])


def test_masked_cells_and_parts_without_ground_have_no_voltage(tmp_path: Path) -> None:
    cells = {"habitat": ["1 1 1 1"], "source": ["1 -9999 -9999 5"], "ground": ["-9999 0 -9999 -9999"]}
    volts = job(tmp_path, use_mask=1, mask=["1 2 0 1"], **cells)[0]
    assert volts[:2] == pytest.approx([1.0, 0.0])
    assert np.isnan(volts[2:]).all()


def test_circuitscape_networks_use_the_last_line_of_a_node(tmp_path: Path) -> None:
    (tmp_path / "e.txt").write_text("0 1 1\n1 2 1\n1 2 1\n2 2 7\n")
    (tmp_path / "s.txt").write_text("0 1\n0 2\n")
    (tmp_path / "g.txt").write_text("2 9\n2 0\n")
    keys = "data_type = network\nscenario = advanced\nhabitat_file = e.txt\nsource_file = s.txt\nground_file = g.txt\n"
    (tmp_path / "net.ini").write_text("\ufeff# [x]\n" + keys + "data_type = network\n", encoding="utf-8")
    assert voltages(rg.read_spice(tmp_path / "net.ini").netlist())["0"] == pytest.approx(3.0)
    summed = {"sources": tmp_path / "s.txt", "grounds": tmp_path / "g.txt"}  # a plain edge list sums all lines
    assert voltages(rg.read_spice(tmp_path / "e.txt", **summed).netlist())["0"] == pytest.approx(4.5)


@pytest.mark.parametrize(
    "head",
    [
        "NROWS 1\nNCOLS 3\nXLLCENTER 1e3\nYLLCENTER -2.5\nCELLSIZE 3.0e+01\nNODATA_VALUE -1.0e0\n",
        "ncols 3\nnrows 1\ndx 2\ndy 2\nnodata -1\n",
    ],
)
@pytest.mark.filterwarnings("ignore:.*lower left corner")
def test_raster_headers_of_all_forms_are_read(tmp_path: Path, head: str) -> None:
    (tmp_path / "cells.asc").write_text(head + "1e0 1.0 -1\n")
    make_raster(tmp_path, "in.asc", ["2 -9999 -9999"])
    make_raster(tmp_path, "out.asc", ["-9999 0 -9999"])
    assert voltages(rg.read_spice(configuration(tmp_path)).netlist()) == pytest.approx(
        {"ground": 0.0, "r0_c0": 2.0, "r0_c1": 0.0}
    )


@pytest.mark.parametrize(
    ("head", "message"),
    [
        ("ncols 2\nncols 2\nnrows 1\n", "ncols twice"),
        ("ncols 2\nnrows 1\ndx 2\ndy 3\n", "2 x 3"),
        ("ncols 2\ncellsize 1\n", "nrows"),
        ("ncols 2\nnrows x\n", "not a number"),
    ],
)
def test_invalid_raster_headers_raise_input_error(tmp_path: Path, head: str, message: str) -> None:
    (tmp_path / "cells.asc").write_text(head + "1 1\n")
    with pytest.raises(rg.InputError, match=message):
        rg.read_spice(configuration(tmp_path))


@pytest.mark.parametrize("form", ["%d", "%.3f", "%g", "%.18e"])
def test_node_numbers_in_numpy_formats_are_read(tmp_path: Path, form: str) -> None:
    np.savetxt(tmp_path / "net.txt", np.array([[0, 1, 100.0], [1, 2000000, 50.0]]), fmt=[form, form, "%.3e"])
    (tmp_path / "in.txt").write_text("0 1\n")
    (tmp_path / "out.txt").write_text("2000000 0\n")
    lists = {"sources": tmp_path / "in.txt", "grounds": tmp_path / "out.txt"}
    assert voltages(rg.read_spice(tmp_path / "net.txt", **lists).netlist())["0"] == pytest.approx(150.0)
    rg.read_spice(tmp_path / "net.txt")  # it looks like a list of edges


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize(
    ("text", "ohms"),
    [
        ('"from";"to";"ohms"\n"a";"b";4\n', 4.0),
        ("a\tb\tsiemens\na\tb\t.25\n", 4.0),
        ("a b weight\na 1e5 4.\n", 4.0),
        ("a b 8 # one of two in parallel\nb a 8\na a 3\n", 4.0),
    ],
)
def test_edge_lists_of_other_programs_are_read(tmp_path: Path, text: str, ohms: float, encoding: str) -> None:
    (tmp_path / "net.txt").write_text(text, encoding=encoding)
    (tmp_path / "in.txt").write_text("a 1\n")
    other = "1e5" if "1e5" in text else "b"
    assert other in rg.read_spice(tmp_path / "net.txt").node_names
    (tmp_path / "out.txt").write_text(f"{other} 0\n")
    lists = {"sources": tmp_path / "in.txt", "grounds": tmp_path / "out.txt", "measure": None}
    assert voltages(rg.read_spice(tmp_path / "net.txt", **lists).netlist())["a"] == pytest.approx(ohms)


@pytest.mark.parametrize("heading", ["a,b,kohm", "a,b,conductance_uS", "a,b,mS", "a,b,R_kOhm"])
def test_headings_with_other_units_are_rejected(tmp_path: Path, heading: str) -> None:
    (tmp_path / "net.csv").write_text(f"{heading}\nx,y,4\n")
    with pytest.raises(rg.InputError, match=r"net\.csv:1: the unit in the heading"):
        rg.read_spice(tmp_path / "net.csv")
    (tmp_path / "net.csv").write_text("a,b,resistance_ohm\nx,y,4\n")
    assert rg.read_spice(tmp_path / "net.csv").resistance.tolist() == [4.0]


def test_node_link_files_of_older_networkx_are_read(tmp_path: Path) -> None:
    double = ("a", "b", {"resistance": 5.0})
    graph = nx.MultiGraph([double, double, ("b", 0, {"conductance": 2})])
    (tmp_path / "net.json").write_text(json.dumps(nx.node_link_data(graph, edges="links")))
    assert rg.read_spice(tmp_path / "net.json").netlist().conductance.tolist() == [0.2, 0.2, 2.0]
    (tmp_path / "net.json").write_text('{"nodes": []}')
    with pytest.raises(rg.InputError, match="the key edges is missing"):
        rg.read_spice(tmp_path / "net.json")
