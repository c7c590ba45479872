"""The voltages that are expected after an update, before anything is iterated."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from support.spaces import space_of

from resgrid.compiler import compile_space
from resgrid.nodal.factors.multigrid import MultigridFactor
from resgrid.nodal.solve import factor
from resgrid.nodal.update import guess as guesses
from resgrid.nodal.watch import Watch
from resgrid.space import Cell, ConfigurationSpace

SIZE = 240
NEW = np.array([[3, 5], [4, 5], [5, 5], [5, 4], [6, 2], [8, 8]])


def rectangles(goals: list[tuple[int, int]]) -> ConfigurationSpace:
    """Rectangles that cover a tenth of a plane, away from the corner."""
    rng, cell = np.random.default_rng(3), np.zeros((SIZE, SIZE), dtype=np.uint8)
    while np.count_nonzero(cell) < 0.1 * cell.size:
        i, j = rng.integers(0, SIZE, 2)
        if i + j > 30:
            cell[i : i + rng.integers(2, 12), j : j + rng.integers(2, 12)] = Cell.OBSTACLE
    for goal in goals:
        cell[goal] = Cell.GOAL
    return space_of(cell)


def factored(space: ConfigurationSpace, boundary: str) -> MultigridFactor:
    factors = factor(compile_space(space, boundary=boundary), method="multigrid")
    assert isinstance(factors, MultigridFactor)
    return factors


def right_side(factors: MultigridFactor) -> NDArray[np.float64]:
    return factors.system.feed + factors.system.injected


def updated(space: ConfigurationSpace, boundary: str) -> tuple[MultigridFactor, NDArray[np.float64]]:
    """The factor after `NEW` have become obstacles, and the voltages before."""
    before = factored(space, boundary)
    old = before.solve(right_side(before), rtol=1e-13)
    after = before.update(NEW)
    assert isinstance(after, MultigridFactor)
    return after, old


def improved(after: MultigridFactor, old: NDArray[np.float64]) -> NDArray[np.float64]:
    assert after.change is not None
    return guesses.improve_guess(after.system, after.change, after.windows, right_side(after), old)


def outside(after: MultigridFactor) -> NDArray[np.bool_]:
    """The rows in no window."""
    assert after.change is not None
    rows = np.ones(after.system.size, dtype=np.bool_)
    rows[after.change.pinned] = False
    for window in after.windows:
        rows[window.rows] = False
    return rows


@pytest.mark.parametrize("boundary", ["dirichlet", "neumann"])
def test_what_lies_outside_the_windows_follows(boundary: str) -> None:
    after, old = updated(rectangles([(0, 0)]), boundary)
    exact, found = after.solve(right_side(after), rtol=1e-13), improved(after, old)
    there = outside(after)
    assert np.abs(found - exact)[there].max() < 0.02 * np.abs(old - exact)[there].max()
    assert after.change is not None
    assert not found[after.change.pinned].any()


def test_the_drop_is_not_scaled_where_another_goal_holds_the_outside() -> None:
    after, old = updated(rectangles([(0, 0), (SIZE - 9, SIZE - 9)]), "dirichlet")
    exact, there = after.solve(right_side(after), rtol=1e-13), outside(after)
    np.testing.assert_array_equal(improved(after, old)[there], old[there])
    found = after.solve(right_side(after), rtol=1e-10, guess=old)
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-8)


def test_hardly_anything_is_left_to_iterate() -> None:
    after, old = updated(rectangles([(0, 0)]), "dirichlet")
    warm, cold = Watch(), Watch()
    exact = after.solve(right_side(after), rtol=1e-13)
    found = after.solve(right_side(after), rtol=1e-8, guess=old, watch=warm)
    after.solve(right_side(after), rtol=1e-8, watch=cold)
    assert warm.iterations <= 2 < cold.iterations
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-7)
    # A guess that solves nothing is no worse than none at all.
    np.testing.assert_allclose(
        after.solve(right_side(after), rtol=1e-10, guess=np.full_like(old, 0.3)), exact, rtol=0, atol=1e-8
    )
