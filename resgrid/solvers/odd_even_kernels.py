"""Compiled loops of the odd-even reduction: rows that no conductance joins to each other are eliminated.

Numba takes seconds to import: only functions that are about to solve import this module.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.jit import kernel
from resgrid.solvers.extended_kernels import _add_product, _canonical

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Indices = NDArray[np.int32]

_MOST_NEIGHBOURS = 8
"""Of a row that is eliminated: they are joined to each other."""


class Rows(NamedTuple):
    """A matrix by rows: `indptr` (n + 1,), `indices`, `data`: edge conductances; `ground` (n,); in siemens."""

    indptr: Indices
    indices: Indices
    data: Floats
    ground: Floats


@kernel
def number_kept(indptr: Indices, indices: Indices, order: Indices, number: Indices) -> int:
    """Number the rows that are kept as they come in an order; -1 for the others.  Returns how many are kept.

    The order is breadth first, backwards.  Not kept are the rows an odd number of steps from the last one that have
    few neighbours, and none as far from it: of a grid's cells, all of one colour.

    Shapes: `order, number` (n,).
    """
    n, count = len(order), 0
    depth = np.full(n, -1, np.int32)
    for k in range(n - 1, -1, -1):
        i = order[k]
        depth[i] = max(depth[i], 0)
        for entry in range(indptr[i], indptr[i + 1]):
            if depth[indices[entry]] < 0:
                depth[indices[entry]] = depth[i] + 1
    for k in range(n):
        i = order[k]
        alone = depth[i] % 2 == 1 and indptr[i + 1] - indptr[i] <= _MOST_NEIGHBOURS
        for entry in range(indptr[i], indptr[i + 1]):
            alone = alone and depth[indices[entry]] != depth[i]
        number[i] = -1 if alone else count
        count += not alone
    return count


@kernel
def most_entries(indptr: Indices, indices: Indices, number: Indices) -> int:
    """Entries that the rows kept have once the others are eliminated, at most."""
    count = 0
    for i in range(len(number)):
        if number[i] < 0:
            count += (indptr[i + 1] - indptr[i]) * (indptr[i + 1] - indptr[i] - 1)
            continue
        for entry in range(indptr[i], indptr[i + 1]):
            count += number[indices[entry]] >= 0
    return count


@kernel
def join_kept(whole: Rows, number: Indices, kept: Indices, pivot: Floats, left: Rows) -> None:
    """Eliminate all rows that are not kept, ``g_ij += g_ik g_kj / d_k``; fills `pivot` (n,), ``d``, and `left`.

    Shapes: `number` (n,), `kept` (kept,).
    """
    indptr, indices, data, ground = whole
    for i in range(len(number)):
        if number[i] < 0:
            total = ground[i]
            for entry in range(indptr[i], indptr[i + 1]):
                total += data[entry]
            pivot[i] = total
    place, count = np.full(len(kept), -1, np.int32), 0
    left.indptr[0] = 0
    for row in range(len(kept)):
        i, begin, grounded = kept[row], count, ground[kept[row]]
        for entry in range(indptr[i], indptr[i + 1]):
            j, first, last, share = indices[entry], entry, entry + 1, 1.0
            if number[j] < 0:
                first, last, share = indptr[j], indptr[j + 1], data[entry] / pivot[j]
                grounded += share * ground[j]
            for other in range(first, last):
                column = number[indices[other]]
                if column == row:
                    continue
                if place[column] < begin:
                    place[column], left.indices[count], left.data[count] = count, column, 0.0
                    count += 1
                left.data[place[column]] += share * data[other]
        left.indptr[row + 1], left.ground[row] = count, grounded


@kernel
def feed_kept(
    whole: Rows, number: Indices, pivot: Floats, m: Floats, e: Integers, kept_m: Floats, kept_e: Integers
) -> None:
    """What is fed into the rows kept once the others are eliminated, ``b_i += g_ik b_k / d_k``, in scaled numbers."""
    indptr, indices, data, _ = whole
    for i in range(len(number)):
        if number[i] >= 0:
            kept_m[number[i]], kept_e[number[i]] = _canonical(m[i], e[i])
    for i in range(len(number)):
        if number[i] >= 0 or m[i] == 0.0:
            continue
        value, scale = _canonical(m[i], e[i])
        for entry in range(indptr[i], indptr[i + 1]):
            k = number[indices[entry]]
            kept_m[k], kept_e[k] = _add_product(kept_m[k], kept_e[k], data[entry] / pivot[i], value, scale)


@kernel
def put_back(
    whole: Rows, number: Indices, pivot: Floats, kept_m: Floats, kept_e: Integers, m: Floats, e: Integers
) -> None:
    """Solve for all rows from those kept, ``x_k = (b_k + sum g_ki x_i) / d_k``, in place of what is fed into them."""
    indptr, indices, data, _ = whole
    for i in range(len(number)):
        if number[i] >= 0:
            m[i], e[i] = kept_m[number[i]], kept_e[number[i]]
            continue
        value, scale = _canonical(m[i], e[i])
        value, scale = _canonical(value / pivot[i], scale)
        for entry in range(indptr[i], indptr[i + 1]):
            k = number[indices[entry]]
            value, scale = _add_product(value, scale, data[entry] / pivot[i], kept_m[k], kept_e[k])
        m[i], e[i] = _canonical(value, scale)
