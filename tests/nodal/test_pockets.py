"""Rows that are left at the end of refinement, solved directly with what surrounds them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from spaces import space_of

from resgrid.compiler import compile_space
from resgrid.nodal import methods
from resgrid.nodal.multigrid import pockets
from resgrid.nodal.multigrid.pockets import PocketsDirectly
from resgrid.nodal.refine import Numbers
from resgrid.nodal.solve import solve
from resgrid.nodal.system import NodalSystem, assemble
from resgrid.space import Cell, ConfigurationSpace

NONE = np.empty(0, dtype=np.int64)


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


def system_of(space: ConfigurationSpace) -> NodalSystem:
    return assemble(compile_space(space, boundary="dirichlet"))


def after_a_first_pass() -> tuple[NodalSystem, NDArray[np.int64], Whole, PocketsDirectly]:
    """The rooms' system, one row in every room, and passes of which the first has been made."""
    system, whole = system_of(rooms_on_a_corridor()), Whole()
    layout = system.netlist.layout
    assert layout is not None
    passes = PocketsDirectly(system, whole)
    passes(np.zeros(system.size), NONE, 0.0)
    return system, np.asarray(system.unknown[layout.node[9, 10::20]], dtype=np.int64), whole, passes


def test_the_first_pass_and_those_that_many_rows_need_are_whole() -> None:
    system = system_of(rooms_on_a_corridor())
    whole = Whole()
    passes = PocketsDirectly(system, whole)
    one, all_rows = np.zeros(system.size), np.ones(system.size)
    one[0] = 1.0
    passes(one, NONE, 0.0)
    passes(all_rows, NONE, 1e-3)
    assert whole.asked == [1, system.size]


def test_few_rows_are_solved_with_what_surrounds_them() -> None:
    system, rows, whole, passes = after_a_first_pass()
    m = np.zeros(system.size)
    m[rows[:4]] = [1.0, -2.0, 3.0, 1e-30]
    x, e = passes(m, NONE, 1e-9)
    assert len(whole.asked) == 1
    assert not e.size
    region = np.flatnonzero(x)
    assert 4 * 8 < len(region) < 4 * 40
    matrix = np.diag(system.degree) - system.coupling.toarray()
    exact = np.linalg.solve(matrix[np.ix_(region, region)], m[region])
    np.testing.assert_allclose(x[region], exact, rtol=1e-10)
    # What leaks out of the slits is all that is left.
    assert np.abs(m - matrix @ x).max() < 1e-4 * np.abs(m).max()


def test_a_whole_pass_follows_where_rows_stay() -> None:
    system, rows, whole, passes = after_a_first_pass()
    m = np.zeros(system.size)
    m[rows[:4]] = 1.0
    passes(m, NONE, 1e-9)
    passes(m, NONE, 1e-9)
    assert whole.asked == [0, 4]
    passes(m, NONE, 1e-9)
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
    monkeypatch.setattr(methods, "may_reduce", lambda _: False)
    netlist = compile_space(rooms_on_a_corridor(), boundary="dirichlet")
    calls: list[int] = []
    solved = pockets._solved

    def counted(system: NodalSystem, region: NDArray[np.int64], m: NDArray[np.float64], e: NDArray[np.int64]) -> object:
        calls.append(len(region))
        return solved(system, region, m, e)

    monkeypatch.setattr(pockets, "_solved", counted)
    point, direct = (solve(netlist, method=method) for method in ("multigrid", "direct"))
    assert point.log_drop is not None
    np.testing.assert_allclose(point.log_drop, direct.log_drop, rtol=0, atol=1e-8, equal_nan=True)
    assert calls
