"""Sensitivities of decisions to resistances, against central differences, dense and banded solutions.

Tests internals: `resgrid.chip.sensitivity`.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.linalg import solveh_banded
from support.circuits import dense_solution, random_grid
from support.dynamics import small_scene
from support.spaces import space_of, spaces

import resgrid as rg
from resgrid.chip.sensitivity import adjoint_of


def central_differences(netlist: rg.Netlist, weights: np.ndarray, step: float = 1e-4) -> np.ndarray:
    """Return central differences of a weighted sum of voltages in logarithms of resistances, by a dense solver.

    Fourth order, so that neither truncation nor rounding spoils the sixth digit.
    """
    result = []
    for k in range(len(netlist.conductance)):
        value = []
        for shift in (2, 1, -1, -2):
            g = netlist.conductance.copy()
            g[k] *= np.exp(-shift * step * 10)
            value.append(weights @ dense_solution(netlist.replace(conductance=g)).voltage)
        result.append((-value[0] + 8 * value[1] - 8 * value[2] + value[3]) / (12 * step * 10))
    return np.array(result)


@settings(max_examples=10)
@given(seed=st.integers(0, 10**6), drive=st.booleans())
@pytest.mark.slow
def test_derivatives_of_random_circuits_equal_central_differences(seed: int, drive: bool) -> None:
    netlist = random_grid(seed, side=4, drive=drive)
    weights = np.zeros(netlist.node_count)
    rng = np.random.default_rng(seed)
    weights[rng.choice(np.arange(4, netlist.node_count), 2, replace=False)] = 1.0, -1.0
    found = rg.study(rg.solve(netlist)).voltage_sensitivity(weights)
    wanted = central_differences(netlist, weights)
    assert np.abs(found - wanted).max() < 1e-6 * np.abs(wanted).max()


@pytest.mark.parametrize("boundary", ["dirichlet", "neumann"])
def test_derivatives_of_a_scene_equal_central_differences(boundary: str) -> None:
    netlist = small_scene(boundary=boundary)
    free = netlist.cells.node[8, 12]
    weights = np.zeros(netlist.node_count)
    weights[free] = 1.0
    found = rg.study(rg.solve(netlist)).voltage_sensitivity(weights)
    some = np.append(np.argsort(-np.abs(found))[:8], [5, 50, 200])
    for k in some.tolist():
        value = []
        for shift in (1e-4, -1e-4):
            g = netlist.conductance.copy()
            g[k] *= np.exp(-shift)
            value.append(rg.solve(netlist.replace(conductance=g)).voltage[free])
        assert found[k] == pytest.approx((value[0] - value[1]) / 2e-4, abs=1e-6 * np.abs(found).max())


def test_derivatives_sum_to_zero_under_a_common_scaling_of_all_resistances() -> None:
    netlist = small_scene()
    weights = np.zeros(netlist.node_count)
    weights[netlist.cells.node[3, 3]] = 1.0
    found = rg.study(rg.solve(netlist)).voltage_sensitivity(weights)
    assert abs(found.sum()) < 1e-12 < np.abs(found).max()


def next_step(op: rg.OperatingPoint, cell: tuple[int, int]) -> int:
    """Return the flat index of the lowest voltage among a cell and its free or goal neighbours."""
    cell_map = op.netlist.cells
    code = cell_map.space.cell
    places = [cell]
    for axis in (0, 1):
        for side in (-1, 1):
            place = list(cell)
            place[axis] += side
            if 0 <= place[axis] < code.shape[axis] and code[tuple(place)] != rg.Cell.OBSTACLE:
                places.append(tuple(place))
    volts = [op.voltage[cell_map.node[place]] for place in places]
    return int(np.ravel_multi_index(places[int(np.argmin(volts))], code.shape))


def test_a_drift_beyond_flip_drift_changes_the_chosen_neighbour() -> None:
    """On the diagonal of a square with the goal in its corner, only mismatch decides between two neighbours."""
    cell = np.zeros((8, 8), dtype=np.uint8)
    cell[0, 0] = 2
    netlist = rg.compile_space(space_of(cell))
    spread = 1.0 + 0.01 * np.random.default_rng(5).standard_normal(len(netlist.conductance))
    netlist = netlist.replace(conductance=netlist.conductance * spread)
    op = rg.solve(netlist)
    node = netlist.cells.node.ravel()
    checked = 0
    for cell in [(i, i) for i in range(1, 8)]:
        result = rg.study(op).sensitivity(cell)
        weights = np.zeros(netlist.node_count)
        weights[node[result.runner_up[0]]], weights[node[result.best[0]]] = 1.0, -1.0
        slope = rg.study(op).voltage_sensitivity(weights)
        assert result.margin[0] == pytest.approx(weights @ op.voltage, abs=1e-12)
        weakest = int(np.argmin(result.flip_drift))
        drift = result.flip_drift[weakest]
        assert drift == pytest.approx(result.margin[0] / abs(slope[weakest]), abs=1e-9)
        if not 1e-4 < drift < 0.05:
            continue
        for share, same in ((0.9, True), (1.1, False)):
            g = netlist.conductance.copy()
            g[weakest] /= 1.0 - np.sign(slope[weakest]) * share * drift
            changed = next_step(rg.solve(netlist.replace(conductance=g)), cell)
            assert (changed == result.best[0]) == same
        checked += 1
    assert checked >= 4


def test_flip_drift_of_a_path_is_the_minimum_over_its_steps() -> None:
    op = rg.solve(small_scene())
    path = rg.streamline(rg.field(op), start=(8.5, 12.5))
    whole = rg.study(op).sensitivity(path.cells)
    each = [rg.study(op).sensitivity(cell).flip_drift for cell in path.cells[:-1]]
    assert whole.flip_drift == pytest.approx(np.min(each, axis=0))
    assert (whole.decision == np.argmin(each, axis=0)).all()
    flips = whole.flips(0.5)
    assert len(flips) == np.count_nonzero(whole.flip_drift <= 0.5)
    assert (np.diff(whole.flip_drift[flips]) >= 0).all()


def test_margins_far_below_rounding_error_still_decide_the_step() -> None:
    cell = np.zeros((120, 3), dtype=np.uint8)
    cell[0] = 2
    result = rg.study(rg.solve(rg.compile_space(space_of(cell)))).sensitivity((115, 1))
    assert result.best[0] == np.ravel_multi_index((114, 1), cell.shape)
    assert 0 < result.margin[0] < 1e-30
    assert np.isfinite(result.flip_drift.min())


def banded_corridor(netlist: rg.Netlist, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the nodal matrix of an open corridor in upper banded form, and the conductances to the goal.

    Substitution with the Cholesky factors of this matrix adds no terms of mixed signs: far entries keep their digits.
    """
    node = netlist.cells.node
    free = node[netlist.cells.space.cell == rg.Cell.FREE]
    row = np.full(netlist.node_count, -1)
    row[free] = np.arange(len(free))
    ends = row[netlist.resistor_nodes]
    band, to_goal = np.zeros((width + 1, len(free))), np.zeros(len(free))
    for side in (0, 1):
        inside = ends[:, side] >= 0
        np.add.at(band[width], ends[inside, side], netlist.conductance[inside])
    a, b = np.sort(ends, axis=1).T
    inner = a >= 0
    band[width - (b - a)[inner], b[inner]] -= netlist.conductance[inner]
    goal = np.isin(netlist.resistor_nodes, netlist.cells.goal_nodes).any(axis=1) & (b >= 0)
    np.add.at(to_goal, b[goal], netlist.conductance[goal])
    return band, to_goal


@pytest.mark.slow
def test_distant_resistors_do_not_flip_a_decision_with_any_method() -> None:
    """Along this corridor the currents grow by 45 orders of magnitude and the adjoint decreases by 45."""
    width = 30
    cell = np.zeros((1000, width), dtype=np.uint8)
    cell[0] = 2
    netlist = rg.compile_space(space_of(cell))
    op = rg.solve(netlist)
    place, lower, aside = (netlist.cells.node[at] for at in ((980, 15), (979, 15), (980, 14)))
    band, to_goal = banded_corridor(netlist, width)
    row = np.full(netlist.node_count, -1)
    row[netlist.cells.node[cell == 0]] = np.arange(len(to_goal))
    rhs = np.zeros((len(to_goal), 2))
    rhs[row[[lower, aside]], [0, 1]] = 1.0
    drop, to_lower, to_aside = np.append(solveh_banded(band, np.column_stack([to_goal, rhs])), [[0.0] * 3], axis=0).T
    first, second = row[netlist.resistor_nodes].T
    # The goal lies a whole volt below the other rail.
    low = np.isin(netlist.resistor_nodes, netlist.cells.goal_nodes)
    volts = np.stack([np.where(low[:, end], 1.0, drop[at]) for end, at in enumerate((first, second))])
    amps = netlist.conductance * (volts[1] - volts[0])
    rising, falling = to_aside[first] - to_aside[second], to_lower[first] - to_lower[second]
    weights = np.zeros(netlist.node_count)
    weights[[aside, lower]] = 1.0, -1.0
    for method in ("multigrid", "direct"):
        adjoint = adjoint_of(op, rg.factorize(netlist, method=method))
        sign, log_size = adjoint.derivatives(weights)
        found = sign * np.exp(log_size)
        assert found == pytest.approx(amps * (rising - falling), abs=2e-5 * np.abs(amps * (rising - falling)).max())
    result = rg.study(op).sensitivity((980, 15))
    assert result.best[0] == np.ravel_multi_index((979, 15), cell.shape)
    margin = abs(drop[row[lower]] - max(drop[row[place]], drop[row[aside]]))
    assert result.margin[0] == pytest.approx(margin, rel=1e-6)
    assert result.flip_drift.min() > 0.5


def test_sensitivity_is_zero_where_sources_fix_every_node() -> None:
    op = rg.solve(rg.Netlist(3, [[1, 0], [2, 1]], [1.0, 1.0], [[1, 0], [2, 0]], [1.0, 2.0]))
    assert not rg.study(op).voltage_sensitivity([0.0, 1.0, 0.0]).any()


def test_sensitivity_of_a_node_without_current_is_zero() -> None:
    """A current flows only beyond ground; its rounding error must not appear at this node."""
    resting = [[7, 0], [5, 7], [6, 5], [2, 6]]
    netlist = rg.Netlist(
        8, [[3, 0], [1, 3], *resting],
        [1.7501931038694856e-3, 3.1193072013202517e-3, 3.1271250039966872e-3, 4.5828841515009757e-4,
         6.449885307398361e-4, 2.512164356057074e-3],
        source_nodes=[[0, 1], [4, 5]], source_volts=[0.9, -2.0],
    )  # fmt: skip
    assert not rg.study(netlist).voltage_sensitivity(np.eye(8)[4]).any()


# 1 V over a divider 1 - 2 - 0.  Without current: the ring 2 - 3 - 4 with dead end 5, and dead ends 6, and 7 - 8.
HANGING = rg.Netlist(
    9, [[1, 2], [2, 0], [2, 3], [3, 4], [4, 2], [4, 5], [2, 6], [0, 7], [7, 8]],
    [1e-3, 3e-3, 1.1e-3, 0.7e-3, 0.3e-3, 1.3e-3, 0.9e-3, 1e-3, 2e-3], source_nodes=[[1, 0]], source_volts=[1.0],
)  # fmt: skip


@pytest.mark.parametrize(("plus", "minus"), [(4, 2), (4, 3), (5, 3), (5, 6), (6, 2), (8, 7), (7, 0)])
def test_voltage_differences_within_a_part_without_current_have_zero_sensitivity(plus: int, minus: int) -> None:
    """No current flows there for any resistances, so that these nodes have one voltage."""
    assert not rg.study(HANGING).voltage_sensitivity(np.eye(9)[plus] - np.eye(9)[minus]).any()


@pytest.mark.parametrize(("plus", "minus"), [(5, 0), (6, 1), (6, 8)])
def test_a_part_without_current_has_the_sensitivity_of_its_connecting_node(plus: int, minus: int) -> None:
    found = rg.study(HANGING).voltage_sensitivity(np.eye(9)[plus] - np.eye(9)[minus])
    assert found == pytest.approx([-0.1875, 0.1875, *[0.0] * 7], abs=1e-12)


@settings(max_examples=20)
@given(space=spaces(max_cells=6))
def test_the_best_neighbour_is_not_higher_on_random_spaces(space: rg.ConfigurationSpace) -> None:
    try:
        op = rg.solve(rg.compile_space(space))
    except rg.CircuitError:
        return
    where = np.argwhere(space.goal_connected)
    if not len(where):
        return
    cell = where[len(where) // 2]
    node = op.netlist.cells.node
    try:
        result = rg.study(op).sensitivity(cell)
    except rg.InputError:
        return
    best = node.ravel()[result.best[0]]
    assert op.voltage[best] <= op.voltage[node[tuple(cell)]]
    assert result.margin[0] >= 0


def test_sensitivity_to_nonlinear_resistors_equals_small_signal_differences() -> None:
    netlist = rg.Netlist(
        3, [[2, 0]], [1e-4], source_nodes=[[1, 0]], source_volts=[1.0],
        nonlinear_nodes=[[1, 2]], nonlinear_current=[1e-4], nonlinear_voltage=[0.5],
    )  # fmt: skip
    found = rg.study(rg.solve(netlist)).voltage_sensitivity([0.0, 0.0, 1.0])

    def volts(linear: float, bent: float) -> float:
        changed = netlist.replace(conductance=[1e-4 / linear], nonlinear_current=[1e-4 / bent])
        return float(rg.solve(changed).voltage[2])

    up, down = np.exp(1e-4), np.exp(-1e-4)
    assert found[0] == pytest.approx((volts(up, 1) - volts(down, 1)) / 2e-4, rel=1e-6)
    assert found[1] == pytest.approx((volts(1, up) - volts(1, down)) / 2e-4, rel=1e-6)


def test_sensitivity_json_lists_the_weakest_resistors() -> None:
    data = rg.study(rg.solve(small_scene())).sensitivity((5, 3)).to_json()
    assert data["smallest_margin"]["unit"] == "V"
    assert len(data["weakest"]) == 10
    assert data["weakest"][0]["cell"] == [5, 3]
    assert data["weakest"][0]["drift"] == data["smallest_flip_drift"]["value"]


@pytest.mark.parametrize(
    ("cells", "word"),
    [((99, 0), "not in the grid"), ((4, 7), "free"), ((11, 2), "free"), (3, "2 whole"), ([0.5, 1], "whole indices")],
)
def test_invalid_cells_raise_input_error(cells: object, word: str) -> None:
    with pytest.raises(rg.InputError, match=word):
        rg.study(rg.solve(small_scene())).sensitivity(cells)


def test_invalid_weights_raise_input_error() -> None:
    op = rg.solve(small_scene())
    with pytest.raises(rg.InputError, match="one per node"):
        rg.study(op).voltage_sensitivity([1.0])
    with pytest.raises(rg.InputError, match="weights = 'all' must be numbers"):
        rg.study(op).voltage_sensitivity("all")
