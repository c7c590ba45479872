"""Counts beyond 2^31, with substitutes that need no memory: shapes without data and broadcast arrays.

Tests internals: `resgrid.circuit.equations`, `resgrid.core.regions`, `resgrid.planning.petsc_fields`,
`resgrid.solvers`, `resgrid.solvers.laplacian`, `resgrid.solvers.multigrid.grid_level`,
`resgrid.solvers.multigrid.red_black`, `resgrid.solvers.petsc_worker`, `resgrid.solvers.supernodal`.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, strategies as st
from support.spaces import space_of

import resgrid as rg
from resgrid.circuit.equations import assemble
from resgrid.core.regions import face_counts
from resgrid.planning.petsc_fields import slabs
from resgrid.solvers import selected_inverse
from resgrid.solvers.laplacian import EdgeList, Laplacian
from resgrid.solvers.multigrid.grid_level import lay_out
from resgrid.solvers.multigrid.red_black import RedBlackLayout
from resgrid.solvers.petsc_worker import local_rows, neighbours, rows_of
from resgrid.solvers.supernodal import factor_supernodes

HUGE = [(2**17, 2**16), (2048, 2048, 2049), (300, 300, 300, 300)]


def test_a_matrix_with_too_many_entries_raises_budget_error() -> None:
    pairs = np.broadcast_to(np.array([[0, 1]], dtype=np.int32), (2**30, 2))
    ones = np.broadcast_to(1.0, len(pairs))
    laplacian = Laplacian(np.ones(2), EdgeList(pairs, ones, np.arange(2, dtype=np.int32)))
    with pytest.raises(rg.BudgetError, match=r"2,147,483,648 entries, .* 32 bits"):
        _ = laplacian.edges


def test_a_grid_with_too_many_slots_has_no_red_black_layout() -> None:
    shape = (2, 2, 2, 2**27)  # odd strides leave gaps, so that slots exceed 2^31 although cells do not
    assert 2 * RedBlackLayout(shape).slots > 2**31 > np.prod(shape, dtype=np.int64)
    pairs, row, node = np.array([[0, 1]], dtype=np.int32), np.arange(2, dtype=np.int32), np.broadcast_to(-1, shape)
    assert lay_out(pairs, np.ones(1), row, cast(Any, node), np.ones(2), 1.0) is None


def test_a_grid_with_too_many_slots_is_solved_as_a_graph(monkeypatch: pytest.MonkeyPatch) -> None:
    netlist = rg.compile_space(scattered((30, 40)))
    by_colour = rg.solve(netlist, method="multigrid")
    monkeypatch.setattr("resgrid.solvers.multigrid.grid_level.MOST_NUMBERED", 1200)
    np.testing.assert_allclose(rg.solve(netlist, method="multigrid").log_drop, by_colour.log_drop, rtol=1e-9)


@pytest.mark.parametrize(("shape", "most"), [((90, 100), 13_000), ((30, 30, 30), 200_000)])
def test_factors_with_too_many_rows_raise_budget_error(
    shape: tuple[int, ...], most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The limits apply to the rows of supernodes by distance and to the members of the quotient graph."""
    netlist = rg.compile_space(scattered(shape))
    expected = rg.solve(netlist)
    monkeypatch.setattr("resgrid.solvers.symbolic.MOST_NUMBERED", most)
    with pytest.raises(rg.BudgetError, match=r"rows have more entries than 32 bits can number: .* 'multigrid'"):
        rg.solve(netlist, method="direct")
    np.testing.assert_allclose(rg.solve(netlist).log_drop, expected.log_drop, rtol=1e-9)


def test_columns_of_large_factors_have_64_bit_indices(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[tuple[np.ndarray, np.ndarray]] = []
    monkeypatch.setattr(selected_inverse, "selected_inverse", lambda starts, rows, *_: seen.append((starts, rows)))
    selected_inverse.positive_inverse_diagonal(
        factor_supernodes(assemble(rg.compile_space(scattered((9, 10)))).laplacian)
    )
    ((starts, rows),) = seen
    assert starts.dtype == np.int64
    assert np.array_equal(rows[starts[:-1]], np.arange(len(starts) - 1))


def scattered(shape: tuple[int, ...]) -> rg.ConfigurationSpace:
    """Space with a fifth of the cells as obstacles and one goal cell."""
    cell = (np.random.default_rng(0).random(shape) < 0.2).astype(np.uint8)
    cell[(0,) * len(shape)] = rg.Cell.GOAL
    return space_of(cell)


@pytest.mark.parametrize("shape", HUGE)
def test_face_counts_beyond_2_to_31_do_not_overflow(shape: tuple[int, ...]) -> None:
    cells = int(np.prod([float(size) for size in shape]))
    assert sum(face_counts(shape)) > len(shape) * cells > 2**31


@given(st.sampled_from(HUGE), st.integers(0, 2**63 - 1))
def test_neighbours_of_cells_beyond_2_to_31_are_correct(shape: tuple[int, ...], seed: int) -> None:
    place = np.random.default_rng(seed).integers(0, shape, (20, len(shape)))
    place[0], place[1] = 0, np.array(shape) - 1

    def number(index: Any) -> Any:
        return np.ravel_multi_index(tuple(index.T), shape)

    assert number(place).max() > 2**31
    for axis in range(len(shape)):
        step = np.zeros(len(shape), dtype=np.int64)
        step[axis] = 1
        after, before = neighbours(number(place), axis, list(shape))
        np.testing.assert_array_equal(after, number((place + step) % shape))
        np.testing.assert_array_equal(before, number((place - step) % shape))


@pytest.mark.parametrize("shape", HUGE)
@pytest.mark.parametrize("ranks", [1, 3, 7])
def test_slabs_and_ranks_cover_every_row(shape: tuple[int, ...], ranks: int) -> None:
    cells = int(np.prod(shape, dtype=np.int64))
    for pieces, whole in (
        ([rows_of(rank, ranks, cells) for rank in range(ranks)], cells),
        (list(slabs(cast(Any, SimpleNamespace(shape=shape)))), shape[0]),
    ):
        assert pieces[0][0] == 0 and pieces[-1][1] == whole
        assert all(one[1] == other[0] for one, other in pairwise(pieces))


def test_a_rank_with_too_many_entries_raises_overflow_error(tmp_path: Path) -> None:
    for name in ("ahead_0", "ahead_1", "ground"):
        np.save(tmp_path / f"{name}.npy", np.ones((6, 6)))
    with pytest.raises(OverflowError, match="180 entries in one rank exceed PETSc's int8: use more ranks"):
        local_rows(tmp_path, [6, 6], 0, 36, np.int8)
    begins, _, _ = local_rows(tmp_path, [6, 6], 0, 18, np.int8)
    assert begins[-1] == 90
