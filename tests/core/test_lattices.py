"""Lattices against analytic functions, conductances derived block by block, networkx, exact geometry and fractions."""

from __future__ import annotations

import itertools
from collections import defaultdict
from fractions import Fraction

import networkx as nx
import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st
from shapely import LineString, box
from support.circuits import dense_solution
from support.fractions_solver import solve_exactly
from support.spaces import space_of

import resgrid as rg

PLANES = ("square8", "hexagonal")


@st.composite
def lattice_spaces(draw: st.DrawFn, name: str) -> rg.ConfigurationSpace:
    """Draw a random space that the lattice accepts, with a goal and a free cell."""
    ndim = 3 if name == "cube26" else 2
    shape = tuple(draw(st.integers(1, 4 if ndim == 3 else 8)) for _ in range(ndim))
    assume(np.prod(shape) > 1)
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    cell = (rng.random(shape) < draw(st.sampled_from([0.0, 0.2, 0.4]))).astype(np.uint8)
    order = rng.permutation(cell.size)
    cell.flat[order[0]], cell.flat[order[1]] = rg.Cell.GOAL, rg.Cell.FREE
    widths = [0.5, 1.0, 2.0] if name == "hexagonal" else [1.0, 1.25, 1.5]
    space = space_of(
        cell,
        periodic=tuple(draw(st.booleans()) for _ in range(ndim)),
        spacing=tuple(draw(st.sampled_from(widths)) for _ in range(ndim)),
        conductivity=10.0 ** rng.uniform(-1, 1, shape) if draw(st.booleans()) else None,
    )
    assume(not (name == "hexagonal" and space.axes[1].periodic and shape[1] == 1))
    return space


def open_space(cells: int, name: str) -> rg.ConfigurationSpace:
    """Return a space of width 1 without obstacles, with a goal in one corner."""
    ndim = 3 if name == "cube26" else 2
    cell = np.zeros((cells,) * ndim, np.uint8)
    cell[(0,) * ndim] = rg.Cell.GOAL
    ratio = (1.0, 1.2, 0.9)[:ndim] if name != "hexagonal" else (1.0, 1.0)
    return space_of(cell, spacing=tuple(h / cells for h in ratio))


def stencil_error(name: str, cells: int, function: object, laplacian: object) -> float:
    """Return the largest error of the compiled Laplacian of a function at nodes away from the edges."""
    netlist = rg.compile_space(open_space(cells, name), lattice=name, resistance=1.0, edge="open")
    found = netlist.lattice_map
    lattice = found.lattice
    sites = np.moveaxis(np.indices(lattice.shape), 0, -1)
    points = np.moveaxis(lattice.points(sites), -1, 0)
    values = function(*points).ravel()
    total = np.zeros(lattice.size)
    there = np.stack([lattice.neighbours(step).ravel() for step in range(len(lattice.steps))])
    other = there[found.resistor_step, found.resistor_site]
    flow = netlist.conductance * (values[other] - values[found.resistor_site])
    np.add.at(total, found.resistor_site, flow)
    np.add.at(total, other, -flow)
    h = float(found.space.spacing.min())
    inner = np.all([(part > 0.25 * part.max()) & (part < 0.75 * part.max()) for part in points], axis=0).ravel()
    return float(np.abs(total / h**2 - laplacian(*points).ravel())[inner].max())


SMOOTH = {
    2: (lambda x, y: np.exp(x) * np.sin(2 * y), lambda x, y: -3 * np.exp(x) * np.sin(2 * y)),
    3: (lambda x, y, z: np.exp(x) * np.sin(2 * y) * z**3,
        lambda x, y, z: np.exp(x) * np.sin(2 * y) * (6 * z - 3 * z**3)),
}  # fmt: skip
HARMONIC = {
    2: lambda x, y: np.exp(3 * x) * np.cos(3 * y),
    3: lambda x, y, z: np.exp(5 * x) * np.cos(3 * y) * np.cos(4 * z),
}


@pytest.mark.parametrize("name", ["square8", "cube26", "hexagonal"])
def test_conductances_approximate_the_laplacian_to_second_order(name: str) -> None:
    function, laplacian = SMOOTH[3 if name == "cube26" else 2]
    coarse, fine = (stencil_error(name, cells, function, laplacian) for cells in (12, 24))
    assert 3.3 < coarse / fine < 4.8


@pytest.mark.parametrize(("name", "ratio"), [("square8", 16), ("cube26", 16), ("hexagonal", 16)])
def test_the_error_for_harmonic_functions_is_of_fourth_order(name: str, ratio: float) -> None:
    function = HARMONIC[3 if name == "cube26" else 2]
    coarse, fine = (stencil_error(name, cells, function, lambda x, *_: 0 * x) for cells in (12, 24))
    assert coarse / fine > 0.8 * ratio


def test_weights_of_square_and_cubic_cells_are_those_of_the_literature() -> None:
    plane = rg.compile_space(open_space(8, "hexagonal"), lattice="square8", resistance=1.0, edge="open")
    assert set(np.unique(plane.conductance.round(12))) == {round(x, 12) for x in (1 / 6, 2 / 3, 2 / 3 + 1 / 6)}
    cell = np.zeros((5, 5, 5))
    cell[0, 0, 0] = 2
    volume = rg.compile_space(space_of(cell), lattice="cube26", resistance=1.0)
    lattice = volume.lattice_map.lattice
    assert set(lattice.weights.round(12)) == {round(x / 30, 12) for x in (14, 3, 1)}
    flat = rg.compile_space(open_space(8, "hexagonal"), lattice="hexagonal", resistance=1.0)
    np.testing.assert_allclose(flat.conductance, 2 / 3)


def expected(space: rg.ConfigurationSpace, boundary: str, edge: str, wall: float) -> dict[tuple[str, str], float]:
    """Return the total conductance between named nodes of square8 or cube26 at R = 1, block by block.

    A block of cells around a corner of the grid has the energy of the stencil, or of face neighbours alone.
    """
    ndim, h = space.ndim, space.spacing
    a = (h.min() / h) ** 2
    c = np.ones(space.shape) if space.conductivity is None else space.conductivity
    tied = {axis for axis in range(ndim) if edge == "obstacle" and boundary != "neumann"}
    total: dict[tuple[str, str], float] = defaultdict(float)

    def at(cell: tuple[int, ...]) -> tuple[int, ...] | None:
        wrapped = tuple(i % n if ring else i for i, n, ring in zip(cell, space.shape, space.periodic, strict=True))
        return wrapped if all(0 <= i < n for i, n in zip(wrapped, space.shape, strict=True)) else None

    def name(cell: tuple[int, ...] | None) -> str | None:
        if cell is None or space.cell[cell] == rg.Cell.OBSTACLE:
            return None if boundary == "neumann" else "obstacle"
        if space.cell[cell] == rg.Cell.GOAL:
            return f"goal_{space.goal_region[cell]}"
        return "n_" + "_".join(map(str, cell)) if boundary != "neumann" or space.goal_connected[cell] else None

    def weight(moves: tuple[bool, ...], whole: bool) -> float:
        if not whole:
            return float(a[list(moves)].sum()) if sum(moves) == 1 else 0.0
        result = 0.0
        for chosen in itertools.product((False, True), repeat=ndim):
            if all(not m or s for m, s in zip(moves, chosen, strict=True)):
                size = sum(chosen)
                factor = {1: 1.0, 2: 1 / 12, 3: 1 / 90}.get(size, 0.0) * float(a[list(chosen)].sum())
                result += factor * (-2.0) ** (size - sum(moves))
        return result

    ranges = [range(n) if ring else range(n + 1) for n, ring in zip(space.shape, space.periodic, strict=True)]
    walled: dict[tuple[str, tuple[int, ...], tuple[int, ...]], float] = defaultdict(float)
    for corner in itertools.product(*ranges):
        cells = [tuple(np.subtract(corner, back).tolist()) for back in itertools.product((0, 1), repeat=ndim)]
        whole = all(at(cell) is not None and space.cell[at(cell)] != rg.Cell.OBSTACLE for cell in cells)
        for one, other in itertools.combinations(cells, 2):
            moves = tuple(i != j for i, j in zip(one, other, strict=True))
            share = weight(moves, whole) / 2 ** (ndim - sum(moves))
            beyond = [i for i, (p, q) in enumerate(zip(one, other, strict=True)) if p != q]
            p, q = at(one), at(other)
            if not share or p == q or (p is None and q is None):
                continue
            if (p is None or q is None) and not set(beyond) <= tied:
                continue
            free = [cell is not None and space.cell[cell] == rg.Cell.FREE for cell in (p, q)]
            if not any(free):
                continue
            values = [c[cell] if cell is not None else 0.0 for cell in (p, q)]
            if free[0] != free[1]:
                values = [values[free.index(True)]] * 2
            first, second = name(p), name(q)
            if first is None or second is None:
                continue
            g = share * 2 * values[0] * values[1] / sum(values)
            key = (min(first, second), max(first, second))
            if "obstacle" in key:
                here, way = (p, np.subtract(other, one)) if free[0] else (q, np.subtract(one, other))
                walled[key[0], here, tuple(way.tolist())] += g  # one contact, from the blocks on both sides
            else:
                total[key] += g
    for (first, *_), g in walled.items():
        total[first, "obstacle"] += 1 / (1 / g + wall)
    return {key: value for key, value in total.items() if value > 1e-14}


def named_totals(netlist: rg.Netlist) -> dict[tuple[str, str], float]:
    """Return the total conductance between named nodes of a netlist."""
    names = netlist.names_of(np.arange(netlist.node_count))
    total: dict[tuple[str, str], float] = defaultdict(float)
    for (i, j), g in zip(netlist.resistor_nodes.tolist(), netlist.conductance.tolist(), strict=True):
        total[min(names[i], names[j]), max(names[i], names[j])] += g
    return total


@settings(max_examples=25, deadline=None)
@given(st.data())
def test_conductances_of_diagonal_lattices_are_those_of_their_blocks(data: st.DataObject) -> None:
    name = data.draw(st.sampled_from(["square8", "cube26"]))
    space = data.draw(lattice_spaces(name))
    boundary, wall = data.draw(st.sampled_from([("dirichlet", 0.0), ("wall", 2.0), ("neumann", 0.0)]))
    edge = data.draw(st.sampled_from(["obstacle", "open"]))
    options = {"wall_resistance": wall} if boundary == "wall" else {}
    try:
        netlist = rg.compile_space(space, boundary=boundary, edge=edge, resistance=1.0, lattice=name, **options)
    except rg.CircuitError:
        assume(False)
    assert dict(named_totals(netlist)) == pytest.approx(expected(space, boundary, edge, wall), rel=1e-12)


@settings(max_examples=30, deadline=None)
@given(st.data())
def test_resistors_of_the_hexagonal_lattice_are_the_segments_clear_of_obstacles(data: st.DataObject) -> None:
    space = data.draw(lattice_spaces("hexagonal"))
    edge = data.draw(st.sampled_from(["obstacle", "open"]))
    netlist = rg.compile_space(space, edge=edge, resistance=1.0, lattice="hexagonal")
    found = netlist.lattice_map
    lattice = found.lattice
    solid = obstacles_of(space)
    codes = space.cell[lattice.site_cells]
    seen = {(int(site), int(step)) for site, step in zip(found.resistor_site, found.resistor_step, strict=True)}
    contacts = np.bincount(found.resistor_site[found.resistor_step < 0], minlength=lattice.size)
    wanted = np.zeros(lattice.size, dtype=int)
    for index in np.ndindex(*lattice.shape):
        site = int(np.ravel_multi_index(index, lattice.shape))
        point = lattice.points(index)
        for step, displacement in enumerate(lattice.steps):
            for sense in (1, -1):
                other = int(lattice.neighbours(step, sense)[index])
                if other == site:
                    continue
                if other < 0:
                    wanted[site] += codes[index] == rg.Cell.FREE and edge == "obstacle"
                    continue
                segment = LineString([point, point + sense * displacement])
                clear = not any(segment.distance(cell) < 1e-7 for cell in solid)
                both = (codes[index], codes.flat[other])
                free = rg.Cell.FREE in both and rg.Cell.OBSTACLE not in both
                if sense > 0:
                    assert ((site, step) in seen) == (clear and free)
                wanted[site] += not clear and codes[index] == rg.Cell.FREE
    np.testing.assert_array_equal(contacts, wanted)


def obstacles_of(space: rg.ConfigurationSpace) -> list[object]:
    """Return the closed boxes of obstacle cells of a plane, with their copies across periodic seams."""
    size = space.upper - space.lower
    boxes = []
    for cell in np.argwhere(space.cell == rg.Cell.OBSTACLE):
        low = space.lower + cell * space.spacing
        for turn in itertools.product(*((-1, 0, 1) if ring else (0,) for ring in space.periodic)):
            boxes.append(box(*(low + turn * size), *(low + turn * size + space.spacing)))
    return boxes


@settings(max_examples=40, deadline=None)
@given(st.data())
def test_sites_are_connected_as_their_cells(data: st.DataObject) -> None:
    name = data.draw(st.sampled_from(["square8", "cube26", "hexagonal"]))
    space = data.draw(lattice_spaces(name))
    netlist = rg.compile_space(space, lattice=name)
    found = netlist.lattice_map
    graph = nx.Graph()
    graph.add_nodes_from(range(1, netlist.node_count))
    between = found.resistor_step >= 0
    graph.add_edges_from(netlist.resistor_nodes[between].tolist())
    goals = set(found.goal_nodes)
    reaching = {node for part in nx.connected_components(graph) if part & goals for node in part}
    node = found.node.ravel()
    code = space.cell[found.lattice.site_cells].ravel()
    connected = space.goal_connected[found.lattice.site_cells].ravel()
    for site in np.flatnonzero(code == rg.Cell.FREE).tolist():
        assert (int(node[site]) in reaching) == bool(connected[site])
    held = set(zip(*(part.ravel().tolist() for part in found.lattice.site_cells), strict=True))
    assert held == set(np.ndindex(*space.shape))


@settings(max_examples=25, deadline=None)
@given(st.data())
def test_the_drop_agrees_with_exact_fractions(data: st.DataObject) -> None:
    name = data.draw(st.sampled_from(["square8", "cube26", "hexagonal"]))
    space = data.draw(lattice_spaces(name))
    assume(space.cell.size <= 30)
    netlist = rg.compile_space(space, lattice=name)
    try:
        op = rg.solve(netlist)
    except rg.CircuitError:
        assume(False)
    exact = solve_exactly(netlist).voltage
    for node in netlist.lattice_map.free_node.tolist():
        if exact[node] is None:
            continue
        drop = Fraction(1) - exact[node]
        if drop > 0:
            assert np.exp(op.log_drop[node]) == pytest.approx(float(drop), rel=1e-9)


@pytest.mark.parametrize("lattice", PLANES)
@pytest.mark.parametrize("options", [{}, {"boundary": "neumann"}, {"boundary": "wall", "wall_resistance": 5e3}])
def test_voltages_agree_with_a_dense_solution(lattice: str, options: dict[str, object]) -> None:
    cell = np.zeros((12, 10), np.uint8)
    cell[3:6, 2:7], cell[8, :4], cell[10, 8] = 1, 1, 2
    netlist = rg.compile_space(space_of(cell), lattice=lattice, **options)
    np.testing.assert_allclose(rg.solve(netlist).voltage, dense_solution(netlist).voltage, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("supply", [2.5, -1.0])
def test_a_corridor_beyond_the_range_of_floats_keeps_its_currents(supply: float) -> None:
    cell = np.ones((400, 3), np.uint8)
    cell[:, 1], cell[-1, 1] = 0, 2
    for lattice in PLANES:
        op = rg.solve(rg.compile_space(space_of(cell), lattice=lattice, supply=supply))
        field = rg.planning.lattice_field(op)
        assert np.nanmin(field.log_drop) < -745
        path = rg.planning.node_path(field, cell=(0, 1))
        rg.certify(path)
        assert path.outcome is rg.Outcome.REACHED


@pytest.mark.parametrize(
    ("lattice", "shape", "spacing", "periodic", "message"),
    [
        ("square8", (3, 3), (1.0, 2.4), None, "sqrt"),
        ("cube26", (3, 3, 3), (1.0, 1.0, 1.9), None, "1.7"),
        ("square8", (3, 3, 3), None, None, "needs 2 axes"),
        ("cube26", (3, 3), None, None, "'square8' or 'hexagonal'"),
        ("hexagonal", (5,), None, None, "needs 2 axes"),
        ("hexagonal", (5, 1), None, (False, True), "does not close on the ring 'y'"),
    ],
)
def test_a_lattice_that_does_not_fit_the_axes_is_rejected(
    lattice: str, shape: tuple[int, ...], spacing: object, periodic: object, message: str
) -> None:
    cell = np.zeros(shape)
    cell.flat[0] = 2
    with pytest.raises(rg.InputError, match=message.replace("(", r"\(")):
        rg.compile_space(space_of(cell, spacing=spacing, periodic=periodic), lattice=lattice)
    with pytest.raises(rg.InputError, match="lattice"):
        rg.compile_space(space_of(cell), lattice="triangular")


def test_the_default_netlist_has_cells_and_other_lattices_reject_their_use() -> None:
    cell = np.zeros((4, 4))
    cell[0, 0] = 2
    space = space_of(cell)
    assert rg.compile_space(space).lattice_map is None
    netlist = rg.compile_space(space, lattice="square8")
    assert netlist.cell_of_node().tolist()[2:] == [-1, *range(1, 16)]
    assert netlist.names_of([0, 1, 2, 3]) == ["0", "obstacle", "goal_0", "n_0_1"]
    with pytest.raises(rg.InputError, match="lattice 'square8'"):
        _ = netlist.cells
    with pytest.raises(rg.InputError, match="rails = 'cells'"):
        rg.compile_space(space, lattice="square8", rails="cells")


@pytest.mark.parametrize("lattice", ["square8", "cube26"])
def test_rings_of_a_single_cell_have_no_resistors(lattice: str) -> None:
    shape = (1,) * (3 if lattice == "cube26" else 2)
    space = space_of(np.full(shape, rg.Cell.GOAL), periodic=(True,) * len(shape))
    netlist = rg.compile_space(space, lattice=lattice)
    assert (netlist.node_count, len(netlist.conductance)) == (2, 0)


def test_conductivities_of_goal_cells_do_not_change_contacts_with_goals() -> None:
    cell = np.zeros((5, 7))
    cell[2, 3], cell[3, 3] = rg.Cell.GOAL, rg.Cell.GOAL
    cost = np.where(cell == rg.Cell.GOAL, 50.0, np.random.default_rng(0).uniform(0.5, 2.0, cell.shape))
    other = np.where(cell == rg.Cell.GOAL, 0.02, cost)
    netlists = [
        rg.compile_space(space_of(cell, spacing=(1.0, 0.95), conductivity=c), lattice="hexagonal")
        for c in (cost, other)
    ]
    ends = [np.any(netlist.resistor_nodes == netlist.lattice_map.goal_nodes[0], axis=1) for netlist in netlists]
    assert ends[0].any()
    np.testing.assert_array_equal(netlists[0].conductance[ends[0]], netlists[1].conductance[ends[1]])
