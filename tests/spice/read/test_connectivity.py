"""Circuitscape jobs in pairwise, one-to-all and all-to-one mode, against dense nodal analysis and hand calculations."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import resgrid as rg

EMPTY = -9999
HABITAT = [[1, 1, 2, 1, 1], [1, EMPTY, 3, 1, 1], [1, 1, 1, 4, 1], [2, 1, 1, 1, EMPTY]]
POINTS = {1: [(0, 0)], 2: [(3, 3)], 4: [(0, 4)]}
REGIONS = {1: [(0, 0), (1, 0), (1, 1)], 2: [(3, 3)], 4: [(0, 4), (1, 4)]}

Places = dict[int, list[tuple[int, int]]]


@pytest.fixture(autouse=True)
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a habitat, focal points and focal regions."""
    monkeypatch.chdir(tmp_path)
    grid("habitat.asc", HABITAT)
    for name, places in (("points.asc", POINTS), ("regions.asc", REGIONS)):
        cells = np.full((4, 5), EMPTY)
        for number, some in places.items():
            cells[tuple(np.array(some).T)] = number
        grid(name, cells.tolist())
    return tmp_path


def grid(name: str, rows: list[list[int]]) -> None:
    """Write an ASCII grid with its lower left corner at (10, 20) and cells of width 2."""
    head = f"ncols {len(rows[0])}\nnrows {len(rows)}\nxllcorner 10\nyllcorner 20\ncellsize 2\nNODATA_value {EMPTY}\n"
    Path(name).write_text(head + "\n".join(" ".join(map(str, row)) for row in rows) + "\n")


def job(scenario: str = "pairwise", points: str = "points.asc", **keys: object) -> rg.spice.ConnectivityResult:
    """Run a job on the habitat of resistances."""
    lines = {
        "scenario": scenario, "habitat_file": "habitat.asc", "habitat_map_is_resistances": True, "point_file": points,
        "output_file": "job.out", **keys,
    }  # fmt: skip
    Path("job.ini").write_text("".join(f"{key} = {value}\n" for key, value in lines.items()))
    return rg.spice.run_circuitscape("job.ini")


def matrix_of(
    habitat: NDArray[np.float64], *, diagonals: bool = True, mean_resistance: bool = False
) -> NDArray[np.float64]:
    """Laplacian matrix of a habitat of resistances, one row per cell."""
    rows, columns = habitat.shape
    matrix = np.zeros((habitat.size, habitat.size))
    for r in range(rows):
        for c in range(columns):
            for dr, dc in ((0, 1), (1, 0), (1, 1), (1, -1)):
                if not (r + dr < rows and 0 <= c + dc < columns) or (dr and dc and not diagonals):
                    continue
                a, b = habitat[r, c], habitat[r + dr, c + dc]
                if EMPTY in (a, b):
                    continue
                siemens = 2 / (a + b) if mean_resistance else (1 / a + 1 / b) / 2
                siemens /= np.hypot(dr, dc)
                i, j = r * columns + c, (r + dr) * columns + c + dc
                matrix[[i, j], [i, j]] += siemens
                matrix[[i, j], [j, i]] -= siemens
    return matrix


def dense_voltages(matrix: NDArray[np.float64], sources: dict[int, float], grounds: list[int]) -> NDArray[np.float64]:
    """Voltages with some cells at 0 V and currents into others."""
    free = [i for i in range(len(matrix)) if i not in grounds and matrix[i, i]]
    voltage = np.zeros(len(matrix))
    amps = np.array([sources.get(i, 0.0) for i in free])
    voltage[free] = np.linalg.solve(matrix[np.ix_(free, free)], amps)
    return voltage


def through(matrix: NDArray[np.float64], voltage: NDArray[np.float64]) -> NDArray[np.float64]:
    """The larger of the currents into every cell and out of it, on the shape of the habitat."""
    current = -np.triu(matrix, 1) * (voltage[:, None] - voltage)
    current = current - current.T
    out, into = np.maximum(current, 0).sum(axis=1), np.maximum(-current, 0).sum(axis=1)
    return np.maximum(into, out).reshape(4, 5)


def flat(place: tuple[int, int]) -> int:
    return place[0] * 5 + place[1]


def written(name: str) -> NDArray[np.float64]:
    return np.loadtxt(name, skiprows=6)


@pytest.mark.parametrize("diagonals", [True, False])
@pytest.mark.parametrize("mean_resistance", [True, False])
def test_pairwise_resistances_and_maps_of_points(diagonals: bool, mean_resistance: bool) -> None:
    keys = {"connect_four_neighbors_only": not diagonals, "connect_using_avg_resistances": mean_resistance}
    matrix = matrix_of(np.array(HABITAT, dtype=float), diagonals=diagonals, mean_resistance=mean_resistance)
    done = job(**keys, write_cur_maps=True, write_volt_maps=True, write_max_cur_maps=True)
    assert done.points.tolist() == [1, 2, 4]
    total, largest = np.zeros((4, 5)), np.zeros((4, 5))
    for i, j in ((0, 1), (0, 2), (1, 2)):
        one, other = (flat(POINTS[done.points[k]][0]) for k in (i, j))
        volts = dense_voltages(matrix, {other: 1.0}, [one])
        assert done.resistance[i, j] == done.resistance[j, i] == pytest.approx(volts[other], rel=1e-12)
        name = f"{done.points[i]}_{done.points[j]}.asc"
        np.testing.assert_allclose(written(f"job_curmap_{name}"), through(matrix, volts), atol=6e-9)
        np.testing.assert_allclose(written(f"job_voltmap_{name}").ravel(), volts, atol=6e-9)
        total += through(matrix, volts)
        largest = np.maximum(largest, through(matrix, volts))
    np.testing.assert_allclose(written("job_cum_curmap.asc"), total, atol=6e-9)
    np.testing.assert_allclose(written("job_max_curmap.asc"), largest, atol=6e-9)
    np.testing.assert_array_equal(job(**keys).resistance.round(12), done.resistance.round(12))


def merged(matrix: NDArray[np.float64], regions: list[list[tuple[int, int]]]) -> NDArray[np.float64]:
    """Laplacian matrix in which all cells of a region are one node, its first cell."""
    for region in regions:
        cells = [flat(cell) for cell in region if HABITAT[cell[0]][cell[1]] != EMPTY]
        for cell in cells[1:]:
            matrix[cells[0]] += matrix[cell]
            matrix[:, cells[0]] += matrix[:, cell]
            matrix[cell] = matrix[:, cell] = 0.0
    return matrix


def test_only_the_regions_of_a_pair_are_wires() -> None:
    done = job(points="regions.asc", connect_using_avg_resistances=True)
    for i, j in ((0, 1), (0, 2), (1, 2)):
        ends = [REGIONS[done.points[k]] for k in (i, j)]
        matrix = merged(matrix_of(np.array(HABITAT, dtype=float), mean_resistance=True), ends)
        volts = dense_voltages(matrix, {flat(ends[1][0]): 1.0}, [flat(ends[0][0])])
        assert done.resistance[i, j] == pytest.approx(volts[flat(ends[1][0])], rel=1e-12)


@pytest.mark.parametrize("places", ["points.asc", "regions.asc"])
def test_one_to_all_and_all_to_one_with_strengths(places: str) -> None:
    Path("strengths.txt").write_text("1 2.5\n4 0.5\n")
    keys = {
        "use_variable_source_strengths": True, "variable_source_file": "strengths.txt", "write_cur_maps": True,
        "connect_using_avg_resistances": True,
    }  # fmt: skip
    regions = POINTS if places == "points.asc" else REGIONS
    matrix = merged(matrix_of(np.array(HABITAT, dtype=float), mean_resistance=True), list(regions.values()))
    node = {number: flat(cells[0]) for number, cells in regions.items()}
    strength = {1: 2.5, 2: 1.0, 4: 0.5}
    out = job("one-to-all", places, **keys)
    for k, number in enumerate((1, 2, 4)):
        others = [node[other] for other in node if other != number]
        volts = dense_voltages(matrix, {node[number]: strength[number]}, others)
        assert out.resistance[k] == pytest.approx(volts[node[number]] / strength[number], rel=1e-12)
        found = written(f"job_curmap_{number}.asc").ravel()
        np.testing.assert_allclose(found[list(node.values())], through(matrix, volts).ravel()[list(node.values())],
                                   atol=6e-9)  # fmt: skip
    back = job("all-to-one", places, **keys)
    assert back.resistance.tolist() == [0, 0, 0]
    volts = dense_voltages(matrix, {node[1]: 2.5, node[4]: 0.5}, [node[2]])
    found = written("job_curmap_2.asc").ravel()
    assert found[node[2]] == pytest.approx(3.0, abs=1e-8)
    np.testing.assert_allclose(found[list(node.values())], through(matrix, volts).ravel()[list(node.values())],
                               atol=6e-9)  # fmt: skip


def test_polygons_join_their_cells_and_the_regions_on_them() -> None:
    cells = np.full((4, 5), EMPTY)
    cells[0, 1:4] = 7
    grid("polygons.asc", cells.tolist())
    done = job(use_polygons=True, polygon_file="polygons.asc", connect_using_avg_resistances=True)
    matrix = merged(matrix_of(np.array(HABITAT, dtype=float), mean_resistance=True), [[(0, 1), (0, 2), (0, 3)]])
    volts = dense_voltages(matrix, {flat((0, 4)): 1.0}, [0])
    assert done.resistance[0, 2] == pytest.approx(volts[flat((0, 4))], rel=1e-12)


def test_pairs_are_included_and_excluded() -> None:
    every = job().resistance
    Path("pairs.txt").write_text("mode include\n1 2\n2 4\n")
    some = job(use_included_pairs=True, included_pairs_file="pairs.txt").resistance
    np.testing.assert_allclose(some, [[0, every[0, 1], -1], [every[0, 1], 0, every[1, 2]], [-1, every[1, 2], 0]])
    Path("pairs.txt").write_text("mode exclude\n1 2\n2 4\n")
    rest = job(use_included_pairs=True, included_pairs_file="pairs.txt").resistance
    np.testing.assert_allclose(rest, [[0, -1, every[0, 2]], [-1, 0, -1], [every[0, 2], -1, 0]])
    Path("pairs.txt").write_text("min 3\nmax 9\n0 1 2 4\n1 0 3 1\n2 3 0 9\n4 1 9 0\n")
    table = job(use_included_pairs=True, included_pairs_file="pairs.txt").resistance
    np.testing.assert_allclose(table, some)
    Path("pairs.txt").write_text("mode exclude\n1 4\n")
    assert job(use_included_pairs=True, included_pairs_file="pairs.txt").points.tolist() == [1, 4]
    Path("pairs.txt").write_text("mode include\n1 4\n")
    assert job(use_included_pairs=True, included_pairs_file="pairs.txt").points.tolist() == [1, 4]


@pytest.mark.parametrize(
    ("heading", "last", "message"), [("1 2 2", 2, "two rows"), ("1 4 2", 4, "column 2 to the point 4")]
)
def test_tables_of_pairs_name_each_point_once(heading: str, last: int, message: str) -> None:
    Path("pairs.txt").write_text(f"min 3\nmax 9\n0 {heading}\n1 0 3 1\n2 3 0 9\n{last} 1 9 0\n")
    with pytest.raises(rg.InputError, match=message):
        job(use_included_pairs=True, included_pairs_file="pairs.txt")


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("habitat.asc", "cellsize", "cellsize 0\nxllcenter", "gives cellsize 0; it must be a positive, finite number"),
        ("habitat.asc", "cellsize", "cellsize nan\nxllcenter", "gives cellsize nan"),
        ("habitat.asc", "xllcorner", "xllcorner inf\nxllcenter", "gives xllcorner inf; it must be a finite number"),
        ("habitat.asc", "\n", "\nyllcenter 1_0\n", "found '1_0'"),
        ("points.txt", "1 ", "1_0 ", "points.txt:1: '1_0 10.5 27' does not consist of numbers"),
    ],
)
def test_numbers_of_headers_and_lists_are_checked(name: str, old: str, new: str, message: str) -> None:
    Path("points.txt").write_text("1 10.5 27\n2 17 21\n4 19 27\n")
    Path(name).write_text(Path(name).read_text().replace(old, new, 1))
    with pytest.raises(rg.InputError, match=message):
        job(points="points.txt")


@pytest.mark.parametrize(("old", "new"), [("xllcorner 10", "xllcorner 12"), ("cellsize 2", "cellsize 2.5")])
def test_a_raster_of_another_place_is_matched_by_row_and_column_with_a_warning(old: str, new: str) -> None:
    wanted = job().resistance
    points = Path("points.asc")
    points.write_text(points.read_text().replace(old, new))
    with pytest.warns(
        UserWarning, match=r"points.asc: its lower left corner is at \(1.*; that of the habitat is at \(10, 20"
    ):
        assert np.array_equal(job().resistance, wanted)


def test_lists_of_points_masks_and_unconnected_points() -> None:
    Path("points.txt").write_text("1 10.5 27\n2 17 21\n4 19 27\n")
    np.testing.assert_allclose(job(points="points.txt").resistance, job().resistance)
    grid("mask.asc", [[1, 1, 0, 1, 1], [1, 1, 0, 1, 1], [1, 1, 0, 1, 1], [1, 1, 0, 1, 1]])
    cut = job(use_mask=True, mask_file="mask.asc", write_cum_cur_map_only=True)
    assert cut.resistance[0].tolist() == [0, -1, -1] and cut.resistance[1, 2] > 0
    assert [file.name for file in cut.files] == [
        "job_resistances.out", "job_resistances_3columns.out", "job_cum_curmap.asc",
    ]  # fmt: skip
    assert cut.cumulative_current is not None and cut.cumulative_current[0, 0] == 0
    one = job("one-to-all", use_mask=True, mask_file="mask.asc")
    assert one.resistance[0] == -1 and one.resistance[1] == pytest.approx(cut.resistance[1, 2])


def test_lines_with_the_number_0_are_left_out_with_a_warning() -> None:
    Path("points.txt").write_text("1 10.5 27\n0 12 27\n2 17 21\n4 19 27\n")
    with pytest.warns(UserWarning, match=r"points.txt: the number 0 is no focal point; number the points from 1"):
        found = job(points="points.txt")
    assert found.points.tolist() == [1, 2, 4]
    np.testing.assert_allclose(found.resistance, job().resistance)


def test_files_have_the_numbers_and_columns_of_circuitscape() -> None:
    done = job(write_cur_maps=True, log_transform_maps=True, set_null_currents_to_nodata=True)
    text = Path("job_resistances.out").read_text().splitlines()
    assert text[0] == "0.0 1.0 2.0 4.0" and text[1].startswith("1.0 0.0 1.43870")
    columns = np.loadtxt("job_resistances_3columns.out")
    np.testing.assert_array_equal(columns[:, :2], [[1, 2], [1, 4], [2, 4]])
    np.testing.assert_allclose(columns[:, 2], done.resistance[np.triu_indices(3, 1)])
    lines = Path("job_curmap_1_2.asc").read_text().splitlines()
    assert lines[:3] == ["ncols         5", "nrows         4", "xllcorner     10.0"]
    assert lines[5] == "NODATA_value  -9999.0"
    assert lines[6].split()[0] == "0.0" and lines[7].split()[1] == "-9999.0"
    from resgrid.spice.networks.circuitscape_files import number_text

    numbers = [1.0, 1e5, 1e6, 123456789.0, 1e-4, 1e-5, 2.5e-7, -9999.0, 0.0, 1.25e20]
    words = ["1.0", "100000.0", "1.0e6", "1.23456789e8", "0.0001", "1.0e-5", "2.5e-7", "-9999.0", "0.0", "1.25e20"]
    assert [number_text(number) for number in numbers] == words


MAPS = {"write_cur_maps": True, "write_volt_maps": True, "write_max_cur_maps": True}


def test_two_points_on_one_node_have_0_ohm_and_maps_of_zeros() -> None:
    Path("points.txt").write_text("1 10.5 27\n2 11 26.5\n4 19 27\n")
    cells = np.full((4, 5), EMPTY)
    cells[0, 1:] = 7
    grid("polygons.asc", cells.tolist())
    polygons = {"use_polygons": True, "polygon_file": "polygons.asc"}
    Path("joined.txt").write_text("1 13 27\n2 19 27\n4 17 21\n")
    for points, more in (("points.txt", {}), ("joined.txt", polygons)):
        done = job(points=points, **MAPS, **more)
        assert done.resistance[0, 1] == 0 and done.resistance[0, 2] > 0
        np.testing.assert_allclose(done.resistance, job(points=points, **more).resistance, rtol=1e-9)
        assert not written("job_curmap_1_2.asc").any() and not written("job_voltmap_1_2.asc").any()


@pytest.mark.parametrize("scenario", ["pairwise", "one-to-all", "all-to-one"])
def test_a_job_without_connections_replaces_older_maps_by_zeros(scenario: str) -> None:
    job(scenario, **MAPS)
    assert written("job_cum_curmap.asc").any() and written("job_max_curmap.asc").any()
    habitat = [[1, 1, EMPTY, 1, 1], [EMPTY] * 5, [1, 1, EMPTY, 1, 1], [2, 1, EMPTY, 1, 1]]
    grid("habitat.asc", habitat)
    done = job(scenario, **MAPS)
    assert (done.resistance[~np.eye(3, dtype=bool)] if scenario == "pairwise" else done.resistance).max() == -1
    names = ["cum_curmap", "max_curmap"]
    if scenario != "pairwise":
        names += [f"{kind}_{number}" for kind in ("curmap", "voltmap") for number in (1, 2, 4)]
    assert not any(written(f"job_{name}.asc").any() for name in names)
    assert done.cumulative_current is not None and not done.cumulative_current.any()
    assert {f"job_{name}.asc" for name in names} <= {file.name for file in done.files}


@pytest.mark.parametrize("error", [KeyboardInterrupt, rg.InputError])
def test_an_unfinished_job_leaves_the_folder_unchanged(error: type[BaseException]) -> None:
    job()
    Path("there").mkdir()
    Path("there/job_resistances.out").write_text("older\n")
    Path("there/summary.json").write_text('{"files": ["notes.txt"]}')
    Path("there/notes.txt").write_text("foreign\n")
    Path("job.ini").write_text(Path("job.ini").read_text() + "write_cur_maps = True\n")
    before = {file.name: file.read_text() for file in Path("there").iterdir()}

    def stop(done: int, total: int) -> None:
        if done == 2:
            raise error("stop")

    for folder in ("there", "new/folder"):
        with pytest.raises(error):
            rg.spice.run_circuitscape("job.ini", folder, progress=stop)
    assert {file.name: file.read_text() for file in Path("there").iterdir()} == before
    assert not Path("new").exists()
    done = rg.spice.run_circuitscape("job.ini", "there")
    assert all(file.is_file() and file.parent == Path("there") for file in done.files)
    assert {file.name for file in Path("there").iterdir()} == {file.name for file in done.files} | set(before)
    assert Path("there/notes.txt").read_text() == "foreign\n"
    with pytest.raises(rg.InputError, match="is a file, and the results need a folder"):
        rg.spice.run_circuitscape("job.ini", "there/notes.txt")


def test_a_network_job_writes_its_tables() -> None:
    Path("graph.txt").write_text("0 1 1\n1 2 2\n2 0 1\n7 8 1\n")
    Path("nodes.txt").write_text("0\n2\n8\n")
    Path("net.ini").write_text(
        "data_type = network\nscenario = pairwise\nhabitat_file = graph.txt\npoint_file = nodes.txt\n"
        "output_file = net.out\nwrite_cur_maps = True\nwrite_volt_maps = True\n"
    )
    done = rg.spice.run_circuitscape("net.ini", "there")
    np.testing.assert_allclose(done.resistance, [[0, 0.75, -1], [0.75, 0, -1], [-1, -1, 0]])
    np.testing.assert_allclose(np.loadtxt("there/net_voltages_0_2.txt")[:3, 1], [0, 0.25, 0.75])
    np.testing.assert_allclose(np.loadtxt("there/net_node_currents_0_2.txt")[:3, 1], [1, 0.25, 1])
    branches = np.loadtxt("there/net_branch_currents_0_2.txt")
    np.testing.assert_allclose(branches[:3], [[0, 1, 0.25], [0, 2, 0.75], [1, 2, 0.25]])
    steps: list[tuple[int, int]] = []
    with ThreadPoolExecutor(2) as pool:
        shared = rg.spice.run_circuitscape(
            "net.ini", "shared", executor=pool, progress=lambda *step: steps.append(step)
        )
    np.testing.assert_array_equal(shared.resistance, done.resistance)
    assert steps == [(1, 3), (2, 3), (3, 3)]


@pytest.mark.filterwarnings("ignore::PendingDeprecationWarning")
def test_geotiff_rasters_give_geotiff_maps() -> None:
    rasterio = pytest.importorskip("rasterio")
    from rasterio.transform import from_origin

    for name, rows in (("habitat", HABITAT), ("points", np.loadtxt("points.asc", skiprows=6))):
        cells = np.array(rows, dtype="float32")
        with rasterio.open(
            f"{name}.tif", "w", driver="GTiff", height=4, width=5, count=1, dtype="float32", nodata=EMPTY,
            transform=from_origin(10, 28, 2, 2),
        ) as target:  # fmt: skip
            target.write(cells, 1)
    expected = job(write_cur_maps=True)
    done = job(points="points.tif", habitat_file="habitat.tif", write_cur_maps=True)
    np.testing.assert_allclose(done.resistance, expected.resistance)
    with rasterio.open("job_cum_curmap.tif") as source:
        np.testing.assert_allclose(source.read(1), written("job_cum_curmap.asc"), rtol=1e-6)
        assert source.transform.c == 10


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"use_reclass_table": True}, "use_reclass_table = True is not supported"),
        ({"compress_grids": "true"}, "compress_grids = true is not supported"),
        ({"set_focal_node_currents_to_zero": 1}, "set_focal_node_currents_to_zero = 1 is not supported"),
        ({"scenario": "advanced"}, "has no focal points; read it with rg.read_spice"),
        ({"scenario": "omni"}, "choose one of pairwise, one-to-all, all-to-one"),
        ({"data_type": "network", "scenario": "one-to-all"}, "no scenario 'one-to-all' for networks"),
        ({"output_file": "../job.out"}, "lies outside"),
        ({"output_file": "None"}, "the key 'output_file' is missing"),
        ({"point_file": "far.txt"}, r"focal point 2 at \(99, 21\) is not on the habitat"),
        ({"point_file": "words.txt"}, "words.txt:2: 'two 3 4' does not consist of numbers"),
        ({"point_file": "single.txt"}, "at least two focal points, got 1"),
        ({"use_included_pairs": True, "included_pairs_file": "words.txt"}, "its first line is neither"),
        ({"use_included_pairs": True, "included_pairs_file": "table.txt"}, "the table of pairs is empty"),
        (
            {"use_included_pairs": True, "included_pairs_file": "range.txt"},
            "range.txt:1: the first two lines are",
        ),
        ({"use_included_pairs": True, "included_pairs_file": "half.txt"}, "a focal point, 2.5, is not a whole number"),
        ({"point_file": "large.txt"}, r"large.txt: the number of a focal point, 1e\+300, is not a whole number"),
        ({"point_file": "beyond.txt"}, r"focal point 2 at \(1e\+300, 21\) is not on the habitat"),
        ({"point_file": "empty.txt"}, "empty.txt: a job needs at least two focal points, got 0"),
        (
            {"point_file": "zero.txt"},
            "two focal points, got 1: the number 0 is no focal point; number the points from 1",
        ),
        (
            {"point_file": "zero.asc"},
            "two focal points, got 1: the number 0 is no focal point; number the points from 1",
        ),
        (
            {"habitat_file": "below.asc"},
            "row 1, column 1 .* of -5; write a positive resistance, or -9999",
        ),
        (
            {"habitat_file": "below.asc", "habitat_map_is_resistances": False},
            "has a conductance of -5; write a positive conductance, or -9999 for an empty cell",
        ),
        ({"habitat_file": "none.asc"}, "has a resistance of 0; define regions without resistance as .* polygons"),
        ({"habitat_file": "../out.asc"}, r"name a folder that contains the file by --root FOLDER \(in Python: root=\)"),
        ({"output_file": "gone/job.out"}, "is in no existing folder; make .*gone' first"),
    ],
)
def test_rejected_jobs(keys: dict[str, object], words: str) -> None:
    Path("far.txt").write_text("1 11 21\n2 99 21\n")
    Path("words.txt").write_text("1 11 21\ntwo 3 4\n")
    Path("single.txt").write_text("1 11 21\n")
    Path("empty.txt").write_text("\n")
    Path("zero.txt").write_text("0 11 21\n2 17 21\n")
    grid("zero.asc", [[0, 0, 0, 0, 1]] * 1 + [[0] * 5] * 3)
    grid("below.asc", [[1] * 5, [1, -5, 3, 1, 1], [1] * 5, [1] * 5])
    grid("none.asc", [[1] * 5, [1, 0, 3, 1, 1], [1] * 5, [1] * 5])
    Path("table.txt").write_text("min 1\nmax 2\n")
    Path("range.txt").write_text("min\nmax 2\n")
    Path("half.txt").write_text("mode include\n1 2.5\n")
    Path("large.txt").write_text("1 11 21\n1e300 13 21\n")
    Path("beyond.txt").write_text("1 11 21\n2 1e300 21\n")
    scenario = str(keys.get("scenario", "pairwise"))
    with pytest.raises(rg.InputError, match=words):
        job(scenario, **{key: value for key, value in keys.items() if key != "scenario"})
    assert not list(Path().glob("job_*"))
