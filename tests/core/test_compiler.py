"""The compiler from spaces to netlists, against conductances that are derived cell by cell."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from support.spaces import space_of, spaces

import resgrid as rg


def expected_conductances(
    space: rg.ConfigurationSpace, boundary: str, edge: str, wall: float, drive: str | None = None
) -> dict[tuple[str, str], float]:
    """Return the total conductance between named nodes at R = 1, by the documented rules, cell by cell."""
    spacing = space.spacing
    c = np.ones(space.shape) if space.conductivity is None else space.conductivity
    total: dict[tuple[str, str], float] = {}

    def name(cell: tuple[int, ...]) -> str | None:
        if space.cell[cell] == rg.Cell.FREE:
            kept = boundary != "neumann" or drive == "none" or space.goal_connected[cell]
            return "n_" + "_".join(map(str, cell)) if kept else None
        if space.cell[cell] == rg.Cell.GOAL:
            return f"goal_{space.goal_region[cell]}"
        return None if boundary == "neumann" else "obstacle"

    def join(a: str | None, b: str | None, g: float) -> None:
        if a is None or b is None or not (a.startswith("n_") or b.startswith("n_")):
            return
        if "obstacle" in (a, b):
            g = 1 / (1 / g + wall)
        key = (min(a, b), max(a, b))
        total[key] = total.get(key, 0.0) + g

    for cell in itertools.product(*map(range, space.shape)):
        for axis, (size, ax) in enumerate(zip(space.shape, space.axes, strict=True)):
            unit = (spacing.min() / spacing[axis]) ** 2
            other = list(cell)
            other[axis] += 1
            if other[axis] == size:
                if not ax.periodic:
                    if edge == "obstacle" and boundary != "neumann":
                        join(name(cell), "obstacle", unit * c[cell])
                    continue
                if size == 1:
                    continue
                other[axis] = 0
            pair = (cell, tuple(other))
            free = [space.cell[p] == rg.Cell.FREE for p in pair]
            values = [c[p] for p in pair]
            if free[0] != free[1]:
                values = [values[free.index(True)]] * 2
            join(name(pair[0]), name(pair[1]), unit * 2 * values[0] * values[1] / sum(values))
            if cell[axis] == 0 and not ax.periodic and edge == "obstacle" and boundary != "neumann":
                pass
        for axis, ax in enumerate(space.axes):
            if cell[axis] == 0 and not ax.periodic and edge == "obstacle" and boundary != "neumann":
                join(name(cell), "obstacle", (spacing.min() / spacing[axis]) ** 2 * c[cell])
    return total


def compiled_conductances(netlist: rg.Netlist) -> dict[tuple[str, str], float]:
    names = netlist.names_of(np.arange(netlist.node_count))
    total: dict[tuple[str, str], float] = {}
    for (a, b), g in zip(netlist.resistor_nodes.tolist(), netlist.conductance.tolist(), strict=True):
        key = (min(names[a], names[b]), max(names[a], names[b]))
        total[key] = total.get(key, 0.0) + g
    return total


@settings(max_examples=60)
@given(spaces(), st.sampled_from(["dirichlet", "neumann", "wall"]), st.sampled_from(["obstacle", "open"]))
def test_conductances_of_random_spaces_equal_the_documented_rules(
    space: rg.ConfigurationSpace, boundary: str, edge: str
) -> None:
    wall = 3.0 if boundary == "wall" else 0.0
    options = {"wall_resistance": wall} if boundary == "wall" else {}
    try:
        netlist = rg.compile_space(space, boundary=boundary, edge=edge, resistance=1.0, **options)
    except rg.CircuitError:
        assert boundary == "neumann" and not space.goal_connected.any()
        return
    expected = expected_conductances(space, boundary, edge, wall)
    found = compiled_conductances(netlist)
    assert found.keys() == expected.keys()
    assert all(np.isclose(found[key], expected[key], rtol=1e-12) for key in expected)


@given(
    spaces(), st.sampled_from(["dirichlet", "neumann", "wall"]), st.sampled_from(["obstacle", "open"]), st.booleans()
)
def test_without_a_drive_every_free_cell_has_a_node(
    space: rg.ConfigurationSpace, boundary: str, edge: str, has_goal: bool
) -> None:
    if not has_goal:
        space = space.with_cells(np.where(space.cell == rg.Cell.GOAL, np.uint8(rg.Cell.FREE), space.cell))
    wall = 3.0 if boundary == "wall" else 0.0
    options = {"wall_resistance": wall} if boundary == "wall" else {}
    netlist = rg.compile_space(space, boundary=boundary, edge=edge, resistance=1.0, drive="none", **options)
    assert (netlist.cells.node[space.cell == rg.Cell.FREE] >= 0).all() and not netlist.current_amps.size
    expected = expected_conductances(space, boundary, edge, wall, drive="none")
    found = compiled_conductances(netlist)
    assert found.keys() == expected.keys()
    assert all(np.isclose(found[key], expected[key], rtol=1e-12) for key in expected)


def test_uniform_drive_injects_equal_currents_into_all_connected_nodes() -> None:
    cell = np.zeros((4, 4))
    cell[0, 0] = 2
    cell[2, :] = 1
    netlist = rg.compile_space(space_of(cell), boundary="neumann", resistance=100.0, supply=2.0)
    assert len(netlist.current_amps) == 7
    assert np.allclose(netlist.current_amps, 2.0 / (100.0 * 7))
    assert np.all(netlist.current_nodes[:, 0] == 0)


def test_rails_cells_gives_every_rail_cell_its_own_source() -> None:
    cell = np.zeros((3, 3))
    cell[0, 0] = cell[0, 1] = 2
    cell[2, 2] = 1
    netlist = rg.compile_space(space_of(cell), rails="cells", edge="open")
    assert netlist.node_count == 10
    assert len(netlist.conductance) == 12
    assert sorted(netlist.source_volts.tolist()) == [0.0, 0.0, 1.0]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"boundary": "dirichlett"}, "dirichlett"),
        ({"drive": "uniform"}, "drive"),
        ({"boundary": "neumann", "drive": "start"}, "start cell"),
        ({"boundary": "neumann", "start": (0, 0)}, "start cell"),
        ({"boundary": "neumann", "drive": "none", "start": (0, 0)}, "leave out start"),
        ({"boundary": "neumann", "drive": "start", "start": (9, 9)}, "not in the grid"),
        ({"boundary": "neumann", "drive": "start", "start": (1, 1)}, "obstacle"),
        ({"boundary": "neumann", "drive": "start", "start": (3, 3)}, "no path"),
        ({"boundary": "wall"}, "wall_resistance"),
        ({"boundary": "wall", "wall_resistance": np.inf}, "neumann"),
        ({"wall_resistance": 1.0}, "wall"),
        ({"edge": "wrap"}, "edge"),
        ({"edge": ("open",)}, "axes"),
        ({"resistance": -1.0}, "resistance"),
        ({"supply": 0.0}, "supply"),
        ({"rails": "tiles"}, "rails"),
    ],
)
def test_invalid_compiler_options_raise_errors(options: dict[str, object], words: str) -> None:
    cell = np.zeros((4, 4))
    cell[0, 3] = 2
    cell[1, 1] = cell[3, 2] = cell[2, 3] = 1
    with pytest.raises(rg.ResgridError, match=words):
        rg.compile_space(space_of(cell), **options)


def test_a_space_without_a_goal_raises_input_error() -> None:
    with pytest.raises(rg.InputError, match="no goal"):
        rg.compile_space(space_of(np.zeros((3, 3))))


def test_more_nodes_than_the_limit_raise_input_error(monkeypatch: pytest.MonkeyPatch) -> None:
    space = space_of(np.array([[0, 0, 1], [0, 0, 2]]))
    monkeypatch.setattr("resgrid.core.compiler.MOST_NODES", 7)
    rg.compile_space(space)
    monkeypatch.setattr("resgrid.core.compiler.MOST_NODES", 6)
    with pytest.raises(rg.InputError, match="4 cells have a node; a netlist may have 6: choose larger cells"):
        rg.compile_space(space)
