"""The operating point of a normwise answer: currents wait until they are asked for, and are the right ones."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest
from support.circuits import dense_solution, ladder, random_grid

import resgrid as rg


@pytest.mark.parametrize("netlist", [ladder(), random_grid(1), random_grid(2, drive=False)])
def test_normwise_readings_are_those_of_a_dense_solution(netlist: rg.Netlist) -> None:
    point, expected = rg.solve(netlist, accuracy="normwise"), dense_solution(netlist)
    for name in ("voltage", "resistor_current", "source_current"):
        np.testing.assert_allclose(getattr(point, name), getattr(expected, name), rtol=1e-9, atol=1e-15)
    assert point.power == pytest.approx(expected.power, rel=1e-12)
    assert point.kcl_residual < 1e-10
    np.testing.assert_array_equal(point.resistor_direction, np.sign(point.resistor_current))
    np.testing.assert_allclose(np.exp(point.resistor_log_current), np.abs(point.resistor_current), rtol=1e-12)


def test_normwise_rails_stand_at_the_voltages_they_were_given() -> None:
    """Counted from the lowest rail, most of these come back with another last digit."""
    volts = np.append(-np.pi, np.linspace(0.01, 0.1, 20))
    rails = np.arange(1, len(volts) + 1)
    to_one_row = np.stack([rails, np.full(len(rails), len(rails) + 1)], axis=1)
    netlist = rg.Netlist(
        len(rails) + 2, to_one_row, np.ones(len(rails)),
        source_nodes=np.stack([rails, np.zeros_like(rails)], axis=1), source_volts=volts,
    )  # fmt: skip
    assert np.any(volts[0] + (volts - volts[0]) != volts)
    for method in ("direct", "multigrid"):
        np.testing.assert_array_equal(rg.solve(netlist, accuracy="normwise", method=method).voltage[rails], volts)


def test_normwise_readings_are_taken_once_and_are_those_of_copies() -> None:
    point = rg.solve(random_grid(3), accuracy="normwise")
    copy = replace(point, iterations=7)
    assert point.resistor_current is point.resistor_current
    np.testing.assert_array_equal(copy.resistor_current, point.resistor_current)
    assert not point.resistor_current.flags.writeable
    assert not point.voltage.flags.writeable


@pytest.mark.parametrize("asked", [False, True])
def test_a_point_survives_pickling(asked: bool) -> None:
    point = rg.solve(random_grid(4), accuracy="normwise")
    if asked:
        assert point.power > 0
    again = pickle.loads(pickle.dumps(point))
    np.testing.assert_array_equal(again.resistor_current, point.resistor_current)
    assert again.power == point.power


def test_currents_of_a_loop_of_sources_warn_at_once() -> None:
    netlist = rg.Netlist(3, [[2, 0]], [1e-3], source_nodes=[[1, 0], [2, 1], [2, 0]], source_volts=[1.0, 1.0, 2.0])
    with pytest.warns(UserWarning, match="form loops"):
        point = rg.solve(netlist.replace(resistor_nodes=[[2, 0]]), accuracy="normwise")
    assert np.all(np.isnan(point.source_current))


@pytest.mark.parametrize(
    ("cells", "start"), [([[0, 2]], (0, 0)), ([[0, 0, 2]], (0, 1)), ([[0, 2], [0, 1]], (0, 0)), ([[0, 2, 0]], (0, 0))]
)
def test_a_start_beside_the_goal_leaves_nothing_to_solve_and_still_has_a_field(
    cells: list[list[int]], start: tuple[int, int]
) -> None:
    cell = np.array(cells, dtype=np.uint8)
    axes = [rg.Axis(name, 0, size, size) for name, size in zip("yx", cell.shape, strict=True)]
    space = rg.ConfigurationSpace(axes, cell)
    for accuracy in ("direction", "normwise"):
        point = rg.solve(
            rg.compile_space(space, boundary="neumann", drive="start", start=start, edge="open"), accuracy=accuracy
        )
        assert point.method == "none" and point.potential is not None
        node = point.netlist.cells.node
        assert point.potential[node[start]] == 1.0 and np.all(point.potential[node[cell == 2]] == 0.0)
        assert point.log_drop is None or point.log_drop[node[cell == 2]].max() == 0.0
        assert rg.streamline(rg.field(point), (0.5, start[1] + 0.5)).outcome == "reached"


@pytest.mark.parametrize("accuracy", ["direction", "normwise"])
@pytest.mark.parametrize("method", ["direct", "multigrid"])
@pytest.mark.parametrize(("conductance", "amps"), [(1e-3, 1e308), (1e-300, 1e10)])
def test_voltages_beyond_the_range_of_doubles_are_refused(
    accuracy: str, method: str, conductance: float, amps: float
) -> None:
    pairs = np.array([[0, 1], [1, 2], [2, 3], [3, 0], [1, 3]])
    drive = np.array([[0, 1]]), np.array([amps])
    netlist = rg.Netlist(4, pairs, np.full(5, conductance), np.empty((0, 2), np.int32), np.empty(0), *drive)
    with pytest.raises(rg.CircuitError, match=r"exceeds 1.8e308 V"):
        rg.solve(netlist, accuracy=accuracy, method=method)


@pytest.mark.parametrize(
    "wrong",
    [
        {"accuracy": "exact"},
        {"method": "lu"},
        {"rtol": 0.0},
        {"rtol": 1.0},
        {"rtol": float("nan")},
        {"rtol": "1e-8"},
        {"rtol": None},
        {"threads": 0},
        {"threads": 1.5},
        {"threads": float("nan")},
        {"threads": None},
        {"progress": "loud"},
    ],
)
def test_wrong_options_are_named(wrong: dict[str, object]) -> None:
    with pytest.raises(rg.InputError, match=next(iter(wrong)) + " = "):
        rg.solve(ladder(3), **wrong)


def test_a_method_that_is_none_is_named_where_nothing_is_left_to_solve() -> None:
    with pytest.raises(rg.InputError, match="method = 'dirct' is unknown; it may be one of auto, direct, multigrid"):
        rg.solve(rg.Netlist(2, [[1, 0]], [1e-3]), method="dirct")


def test_small_currents_beside_large_ones_are_kept_beyond_the_rails() -> None:
    """Ground is no rail of node 3, which lies between 1 V and 2 V; two loads lead there from 1 V."""
    netlist = rg.Netlist(4, [[2, 3], [3, 1], [1, 0], [1, 0]], [1e-4, 1e-4, 1e3, 1e-5], [[1, 0], [2, 0]], [1.0, 2.0])
    point = rg.solve(netlist)
    np.testing.assert_allclose(point.resistor_current, [5e-5, 5e-5, 1e3, 1e-5], rtol=1e-14)
    assert point.resistor_direction.tolist() == [1, 1, 1, 1]


def test_a_grid_that_nothing_drives_is_told_by_the_key_that_would() -> None:
    """Not by an option: the message is read on the live page and in Python, too."""
    axes = rg.Axis("x", 0.0, 3.0, 3), rg.Axis("y", 0.0, 2.0, 2)
    space = rg.ConfigurationSpace(axes, [[0, 0], [0, 0], [0, 2]])
    with pytest.raises(rg.CircuitError, match=r"nothing is driven: .*\(boundary = 'neumann'\)$"):
        rg.solve(rg.compile_space(space, edge="open"))


def test_a_node_held_between_the_rails_has_no_drop_but_a_potential() -> None:
    """Its drop would be the difference of voltages that are rounded."""
    held = rg.solve(
        rg.Netlist(4, [[1, 3], [3, 0]], [1e-3] * 2, source_nodes=[[1, 0], [1, 2]], source_volts=[1.0, 1e-12])
    )
    assert held.log_drop is not None
    assert held.potential is not None
    np.testing.assert_allclose(held.log_drop, [0.0, -np.inf, np.nan, np.log(0.5)], rtol=1e-15)
    np.testing.assert_allclose(held.potential, [0.0, 1.0, 1.0, 0.5], rtol=1e-11)
