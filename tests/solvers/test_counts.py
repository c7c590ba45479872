"""Counts beyond 2^31, by stand-ins that take no memory: shapes alone, and arrays that repeat one value."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, strategies as st

import resgrid as rg
from resgrid.circuit.slabs import slabs
from resgrid.grids import face_counts
from resgrid.solvers.laplacian import EdgeList, Laplacian
from resgrid.solvers.petsc_worker import local_rows, neighbours, rows_of

HUGE = [(2**17, 2**16), (2048, 2048, 2049), (300, 300, 300, 300)]


def test_a_matrix_of_more_entries_than_rows_can_number_is_refused() -> None:
    pairs = np.broadcast_to(np.array([[0, 1]], dtype=np.int32), (2**30, 2))
    ones = np.broadcast_to(1.0, len(pairs))
    laplacian = Laplacian(np.ones(2), EdgeList(pairs, ones, np.arange(2, dtype=np.int32)))
    with pytest.raises(rg.BudgetError, match=r"2,147,483,648 entries, .* 32 bits"):
        _ = laplacian.edges


@pytest.mark.parametrize("shape", HUGE)
def test_faces_are_counted_in_whole_numbers_without_end(shape: tuple[int, ...]) -> None:
    cells = int(np.prod([float(size) for size in shape]))
    assert sum(face_counts(shape)) > len(shape) * cells > 2**31


@given(st.sampled_from(HUGE), st.integers(0, 2**63 - 1))
def test_ranks_find_the_neighbours_of_cells_beyond(shape: tuple[int, ...], seed: int) -> None:
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
def test_slabs_and_ranks_leave_no_row_out(shape: tuple[int, ...], ranks: int) -> None:
    cells = int(np.prod(shape, dtype=np.int64))
    for pieces, whole in (
        ([rows_of(rank, ranks, cells) for rank in range(ranks)], cells),
        (list(slabs(cast(Any, SimpleNamespace(shape=shape)))), shape[0]),
    ):
        assert pieces[0][0] == 0 and pieces[-1][1] == whole
        assert all(one[1] == other[0] for one, other in pairwise(pieces))


def test_a_rank_of_more_entries_than_petsc_can_number_says_so(tmp_path: Path) -> None:
    for name in ("ahead_0", "ahead_1", "ground"):
        np.save(tmp_path / f"{name}.npy", np.ones((6, 6)))
    with pytest.raises(OverflowError, match="180 entries in one rank exceed PETSc's int8: use more ranks"):
        local_rows(tmp_path, [6, 6], 0, 36, np.int8)
    begins, _, _ = local_rows(tmp_path, [6, 6], 0, 18, np.int8)
    assert begins[-1] == 90
