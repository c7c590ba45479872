"""Rows that are left at the end of refinement, solved directly with what surrounds them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from support.spaces import space_of

from resgrid.circuit.equations import Equations, assemble
from resgrid.circuit.solve import solve
from resgrid.compiler import compile_space
from resgrid.solvers import decay, refine as refinement
from resgrid.solvers.choose import factor_laplacian
from resgrid.solvers.extended import Scaled
from resgrid.solvers.laplacian import Laplacian
from resgrid.solvers.refine import LocalCorrections, Numbers
from resgrid.space import Cell, ConfigurationSpace


def plain(m: NDArray[np.float64]) -> Numbers:
    """Doubles as scaled numbers."""
    return m, np.zeros(len(m), dtype=np.int64)


def rooms_on_a_corridor(count: int = 40) -> ConfigurationSpace:
    """Rooms of three cells, far from each other, behind slits of five cells."""
    cell = np.full((11, 20 * count), Cell.OBSTACLE, dtype=np.uint8)
    cell[1:3, 1:-1] = Cell.FREE
    for k in range(count):
        cell[3:10, 20 * k + 10] = Cell.FREE
        cell[8:10, 20 * k + 9 : 20 * k + 12] = Cell.FREE
    cell[1, 1] = Cell.GOAL
    return space_of(cell)


class Whole:
    """Remembers what it is asked."""

    def __init__(self) -> None:
        self.asked: list[int] = []

    def __call__(self, m: NDArray[np.float64], e: NDArray[np.int64], _accuracy: float) -> Numbers:
        self.asked.append(np.count_nonzero(m))
        return np.zeros_like(m), np.zeros_like(e)


def system_of(space: ConfigurationSpace) -> Equations:
    return assemble(compile_space(space, boundary="dirichlet"))


def after_a_first_pass() -> tuple[Equations, NDArray[np.int64], Whole, LocalCorrections]:
    """The rooms' system, one row in every room, and passes of which the first has been made."""
    system, whole = system_of(rooms_on_a_corridor()), Whole()
    cell_map = system.netlist.cells
    passes = LocalCorrections(system.laplacian, whole)
    passes(*plain(np.zeros(system.size)), 0.0)
    return system, np.asarray(system.unknown[cell_map.node[9, 10::20]], dtype=np.int64), whole, passes


def test_the_first_pass_and_those_that_many_rows_need_are_whole() -> None:
    system = system_of(rooms_on_a_corridor())
    whole = Whole()
    passes = LocalCorrections(system.laplacian, whole)
    one, all_rows = np.zeros(system.size), np.ones(system.size)
    one[0] = 1.0
    passes(*plain(one), 0.0)
    passes(*plain(all_rows), 1e-3)
    assert whole.asked == [1, system.size]


def test_few_rows_are_solved_with_what_surrounds_them() -> None:
    system, rows, whole, passes = after_a_first_pass()
    m = np.zeros(system.size)
    m[rows[:4]] = [1.0, -2.0, 3.0, 1e-30]
    x, e = passes(*plain(m), 1e-9)
    assert len(whole.asked) == 1
    assert not e.any()
    region = np.flatnonzero(x)
    assert 4 * 8 < len(region) < 4 * 40
    matrix = np.diag(system.laplacian.diagonal) - system.laplacian.edges.toarray()
    exact = np.linalg.solve(matrix[np.ix_(region, region)], m[region])
    np.testing.assert_allclose(x[region], exact, rtol=1e-10)
    # What leaks out of the slits is all that is left.
    assert np.abs(m - matrix @ x).max() < 1e-4 * np.abs(m).max()


def test_what_lies_around_currents_into_a_slit_is_solved_first() -> None:
    system = system_of(rooms_on_a_corridor())
    assert system.rails is not None
    whole, current = Whole(), system.rails.to_low
    passes = LocalCorrections(system.laplacian, whole, in_slit=True)
    x, _ = passes(*plain(current), 0.0)
    assert not whole.asked
    matrix = np.diag(system.laplacian.diagonal) - system.laplacian.edges.toarray()
    left = current - matrix @ x
    left[np.abs(left) < 1e-14] = 0.0
    few = (x, np.zeros(system.size, dtype=np.int64)), (current, np.zeros(system.size, dtype=np.int64))
    assert passes.anew(left, *few) is None
    passes(*plain(left), 0.0)
    assert whole.asked == [np.count_nonzero(left)]
    assert passes.anew(left, *few) is not None


def test_a_goal_in_a_slit_spares_a_pass(monkeypatch: pytest.MonkeyPatch) -> None:
    """Some twelve decades from the goal to the room."""
    cell = np.full((200, 315), Cell.OBSTACLE, dtype=np.uint8)
    cell[6, 1:15] = cell[1:-1, 15:-1] = Cell.FREE
    cell[6, 1] = Cell.GOAL
    netlist = compile_space(space_of(cell), boundary="dirichlet")
    point, direct = (solve(netlist, method=method) for method in ("multigrid", "direct"))
    assert point.log_drop is not None
    np.testing.assert_allclose(point.log_drop, direct.log_drop, rtol=0, atol=point.entry_error, equal_nan=True)
    monkeypatch.setattr(decay, "_STEEP", np.inf)
    assert point.iterations < 0.8 * solve(netlist, method="multigrid").iterations


def test_a_whole_pass_follows_where_rows_stay() -> None:
    system, rows, whole, passes = after_a_first_pass()
    m = np.zeros(system.size)
    m[rows[:4]] = 1.0
    passes(*plain(m), 1e-9)
    passes(*plain(m), 1e-9)
    assert whole.asked == [0, 4]
    passes(*plain(m), 1e-9)
    assert whole.asked == [0, 4]


def test_pockets_have_exponents_of_their_own() -> None:
    system, rows, _, passes = after_a_first_pass()
    m, e = np.zeros(system.size), np.zeros(system.size, dtype=np.int64)
    first, other = rows[[0, 3]]
    m[first], m[other] = 1.0, 1.0
    e[other] = -40
    x, exponent = passes(m, e, 1e-9)
    assert exponent[first] == 0
    assert exponent[other] == -40
    assert x[other] == pytest.approx(x[first], rel=1e-6)


def test_refinement_ends_with_pockets(monkeypatch: pytest.MonkeyPatch) -> None:
    netlist = compile_space(rooms_on_a_corridor(), boundary="dirichlet")
    calls: list[int] = []
    around = refinement._around

    def counted(laplacian: Laplacian, rows: NDArray[np.int64]) -> NDArray[np.int64] | None:
        calls.append(len(rows))
        return around(laplacian, rows)

    monkeypatch.setattr(refinement, "_around", counted)
    point, direct = (solve(netlist, method=method) for method in ("multigrid", "direct"))
    assert point.log_drop is not None
    np.testing.assert_allclose(point.log_drop, direct.log_drop, rtol=0, atol=1e-8, equal_nan=True)
    assert calls


@pytest.mark.parametrize("length", [60, 600])
def test_what_lies_along_a_slit_is_found_from_what_flows_in(length: int) -> None:
    """Half a decade a cell: beyond what a double spans after some five hundred cells."""
    cell = np.full((120, 120 + length), Cell.OBSTACLE, dtype=np.uint8)
    cell[1:-1, 1:115] = cell[6, 115:-1] = cell[20, 115 : 115 + length // 2] = Cell.FREE
    cell[6, 4] = Cell.GOAL
    system = system_of(space_of(cell))
    cell_map = system.netlist.cells
    assert system.rails is not None
    current = system.rails.to_low, np.zeros(system.size, dtype=np.int64)
    exact, _ = factor_laplacian(system.laplacian, "direct").solve_nonnegative(system.rails.to_low)
    wrong, exponent = exact.hi.copy(), exact.exponent.copy()
    rows = system.unknown[cell_map.node[6, 118:-1]].astype(np.int64)
    wrong[rows], exponent[rows] = -1e-13, 0
    left = np.zeros(system.size)
    left[np.random.default_rng(1).choice(rows, len(rows) // 2, replace=False)] = 1.0
    passes = LocalCorrections(system.laplacian, Whole())
    found = passes.anew(left, (wrong, exponent), current)
    assert found is not None
    region, (m, e) = found
    assert set(rows) <= set(region)
    log, expected = Scaled(m, np.zeros_like(m), e).log, exact.log[region]
    np.testing.assert_allclose(log, expected, rtol=0, atol=1e-11)
    # Half of the rows must be right for another try.
    assert passes.anew(left, (wrong, exponent), current) is None


def test_rows_without_a_digit_are_found_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """Some two hundred decades, a room at the end of a slit, and a pass over the whole that gains twelve at a time."""
    cell = np.full((120, 420), Cell.OBSTACLE, dtype=np.uint8)
    cell[1:-1, 1:115] = cell[6, 115:400] = cell[3:9, 400:406] = cell[40, 115:160] = Cell.FREE
    cell[6, 4] = Cell.GOAL
    netlist = compile_space(space_of(cell), boundary="dirichlet")
    point, direct = (solve(netlist, method=method) for method in ("multigrid", "direct"))
    assert point.log_drop is not None
    assert direct.log_drop is not None
    assert point.log_drop[np.isfinite(point.log_drop)].min() < -150 * np.log(10.0)
    np.testing.assert_allclose(point.log_drop, direct.log_drop, rtol=0, atol=point.entry_error, equal_nan=True)
    monkeypatch.setattr(LocalCorrections, "anew", lambda *_: None)
    assert point.iterations < 0.5 * solve(netlist, method="multigrid").iterations
