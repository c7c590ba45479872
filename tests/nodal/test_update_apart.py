"""Updates that leave rows alone: pinned at a rail, cut off, or at rest before."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import splu
from support.spaces import space_of

from resgrid.compiler import compile_space
from resgrid.errors import CircuitError, InputError
from resgrid.nodal.factors.multigrid import MultigridFactor
from resgrid.nodal.solve import factor
from resgrid.space import Cell


def test_rows_that_an_update_has_cut_off_are_in_no_window_of_the_next() -> None:
    """They were left out twice of what holds the outside, whose rise could be anything then."""
    cell = np.zeros((60, 60), dtype=np.uint8)
    cell[30, 40] = 2
    cell[20:27, [20, 26]] = cell[20, 20:27] = 1
    after = factor(compile_space(space_of(cell), boundary="neumann"), method="multigrid").update(
        [[26, k] for k in range(21, 26)]
    )
    guess = after.solve(after.system.drive, rtol=1e-8)
    for cells in ([[28, 23]], [[23, 28], [24, 28]]):
        after = after.update(cells)
        assert isinstance(after, MultigridFactor)
        assert after.change is not None
        assert after.windows
        assert len(after.change.pinned) > 30
        for window in after.windows:
            assert not np.isin(after.change.pinned, window.rows).any()
        exact = after.solve(after.system.drive, rtol=1e-13)
        found = after.solve(after.system.drive, rtol=1e-8, guess=guess)
        np.testing.assert_allclose(found, exact, rtol=0, atol=1e-7 * np.abs(exact).max())


@pytest.mark.parametrize("wall_resistance", [1e4, 1e9, 1e13])
def test_rows_pinned_behind_stiff_walls_do_not_drown_the_others(wall_resistance: float) -> None:
    cell = np.zeros((60, 60), dtype=np.uint8)
    cell[20, 20] = 2
    netlist = compile_space(space_of(cell), boundary="wall", wall_resistance=wall_resistance)
    before = factor(netlist, method="multigrid")
    old = before.solve(before.system.drive, rtol=1e-8)
    after = before.update(np.argwhere(np.ones((5, 5))) + 40)
    assert after.change is not None
    system, pinned = after.system, after.change.pinned
    exact = splu((sparse.diags_array(system.degree) - system.coupling).tocsc()).solve(system.drive)
    free = np.setdiff1d(np.arange(system.size), pinned)
    for guess in (None, old):
        found = after.solve(system.drive, rtol=1e-8, guess=guess)
        np.testing.assert_allclose(found[pinned], exact[pinned], rtol=1e-12)
        np.testing.assert_allclose(found[free], exact[free], rtol=0, atol=1e-7 * np.abs(exact[free]).max())


@pytest.mark.parametrize("seed", [5, 17, 20])
def test_patched_levels_or_new_ones_keep_what_rtol_promises_six_decades_apart(seed: int) -> None:
    cell = np.pad([[2]], ((5, 54), (5, 24)))
    space = space_of(cell, conductivity=10.0 ** np.random.default_rng(seed).uniform(-3, 3, cell.shape))
    after = factor(compile_space(space), method="multigrid").update([[k, 20] for k in range(59)])
    assert isinstance(after, MultigridFactor)
    assert after.patched is not None
    system = after.system
    found = after.solve(system.drive, rtol=1e-8)
    # What rtol promises is the backward error; six decades of conductance make more of it in voltages.
    left = system.degree * found - system.coupling @ found - system.drive
    scale = 2 * system.degree.max() * np.linalg.norm(found) + np.linalg.norm(system.drive)
    assert np.linalg.norm(left) <= 1e-8 * scale
    np.testing.assert_array_equal(after.solve(system.drive, rtol=1e-8), found)


def test_a_rail_beside_nodes_at_rest_is_refused_where_it_would_feed_them() -> None:
    """Behind the goal nothing flows until another rail comes there."""
    cell = np.zeros((21, 1), dtype=np.uint8)
    cell[0], cell[10] = 1, 2
    held = factor(compile_space(space_of(cell), edge="open"), method="direct")
    with pytest.raises(InputError, match="carries no current yet"):
        held.update([[20, 0]])
    beside = held.update([[20, 0]], to=Cell.GOAL)
    np.testing.assert_array_equal(beside.solve(beside.system.drive), held.solve(held.system.drive))


def test_what_elimination_leaves_of_an_updated_circuit_has_sums_of_its_own() -> None:
    """The update leaves a part that nothing holds, so that the circuit is factored anew."""
    cell = np.array(
        [
            [[0, 1, 1], [1, 0, 0], [0, 0, 0], [1, 1, 1]],
            [[1, 0, 2], [0, 0, 1], [0, 1, 1], [0, 1, 1]],
            [[1, 0, 1], [1, 0, 0], [1, 0, 1], [1, 0, 0]],
        ],
        dtype=np.uint8,
    )
    space = space_of(cell, periodic=(True, False, False))
    factors = factor(compile_space(space, boundary="neumann"), method="direct")
    for place in np.argwhere(space.goal_connected):
        try:
            updated = factors.update([place], to=1)
        except CircuitError:
            continue  # nothing is driven any more
        x = updated.solve(updated.system.drive, rtol=1e-12)
        np.testing.assert_allclose(updated.system.matrix @ x, updated.system.drive, atol=1e-17)
