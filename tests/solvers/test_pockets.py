"""Direct solution of the remaining rows at the end of refinement, compared with the direct method.

Tests internals: `resgrid.circuit.equations`, `resgrid.solvers`, `resgrid.solvers.method_choice`,
`resgrid.solvers.scaled`.
"""

from __future__ import annotations

import numpy as np
import pytest
from support.spaces import space_of

import resgrid as rg
from resgrid.circuit.equations import Equations, assemble
from resgrid.solvers import refinement
from resgrid.solvers.method_choice import factor_laplacian
from resgrid.solvers.scaled import Scaled


def rooms_on_a_corridor(count: int = 40) -> rg.ConfigurationSpace:
    """A corridor with distant small pockets behind slits of five cells."""
    cell = np.full((11, 20 * count), rg.Cell.OBSTACLE, dtype=np.uint8)
    cell[1:3, 1:-1] = rg.Cell.FREE
    for k in range(count):
        cell[3:10, 20 * k + 10] = rg.Cell.FREE
        cell[8:10, 20 * k + 9 : 20 * k + 12] = rg.Cell.FREE
    cell[1, 1] = rg.Cell.GOAL
    return space_of(cell)


def system_of(space: rg.ConfigurationSpace) -> Equations:
    return assemble(rg.compile_space(space, boundary="dirichlet"))


def test_multigrid_agrees_with_direct_for_a_goal_in_a_slit() -> None:
    """The potential decreases by about twelve orders of magnitude along the slit."""
    cell = np.full((200, 315), rg.Cell.OBSTACLE, dtype=np.uint8)
    cell[6, 1:15] = cell[1:-1, 15:-1] = rg.Cell.FREE
    cell[6, 1] = rg.Cell.GOAL
    netlist = rg.compile_space(space_of(cell), boundary="dirichlet")
    point, direct = (rg.solve(netlist, method=method) for method in ("multigrid", "direct"))
    assert point.log_drop is not None
    np.testing.assert_allclose(point.log_drop, direct.log_drop, rtol=0, atol=point.entry_error, equal_nan=True)


def test_multigrid_agrees_with_direct_in_pockets_behind_slits() -> None:
    netlist = rg.compile_space(rooms_on_a_corridor(), boundary="dirichlet")
    point, direct = (rg.solve(netlist, method=method) for method in ("multigrid", "direct"))
    assert point.log_drop is not None
    np.testing.assert_allclose(point.log_drop, direct.log_drop, rtol=0, atol=1e-8, equal_nan=True)


@pytest.mark.parametrize("length", [60, 600])
def test_rows_along_a_slit_are_resolved_from_their_neighbours(length: int) -> None:
    """The potential decreases by about half an order of magnitude per cell, below the double range after 500 cells."""
    cell = np.full((120, 120 + length), rg.Cell.OBSTACLE, dtype=np.uint8)
    cell[1:-1, 1:115] = cell[6, 115:-1] = cell[20, 115 : 115 + length // 2] = rg.Cell.FREE
    cell[6, 4] = rg.Cell.GOAL
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
    found = refinement.resolve_rows(system.laplacian, left, Scaled(wrong, np.zeros_like(wrong), exponent), current)
    assert found is not None
    np.testing.assert_allclose(found.log, exact.log, rtol=0, atol=1e-11)


def test_resolving_rows_halves_the_iterations(monkeypatch: pytest.MonkeyPatch) -> None:
    """A slit over about two hundred orders of magnitude, of which one iteration of all rows gains twelve."""
    cell = np.full((120, 420), rg.Cell.OBSTACLE, dtype=np.uint8)
    cell[1:-1, 1:115] = cell[6, 115:400] = cell[3:9, 400:406] = cell[40, 115:160] = rg.Cell.FREE
    cell[6, 4] = rg.Cell.GOAL
    netlist = rg.compile_space(space_of(cell), boundary="dirichlet")
    point, direct = (rg.solve(netlist, method=method) for method in ("multigrid", "direct"))
    assert point.log_drop is not None
    assert direct.log_drop is not None
    assert point.log_drop[np.isfinite(point.log_drop)].min() < -150 * np.log(10.0)
    np.testing.assert_allclose(point.log_drop, direct.log_drop, rtol=0, atol=point.entry_error, equal_nan=True)
    monkeypatch.setattr(refinement, "resolve_rows", lambda *_: None)
    assert point.iterations < 0.5 * rg.solve(netlist, method="multigrid").iterations
