"""Compiled kernels of forward and back substitution in an elimination tree (`resgrid.solvers.elimination_tree`).

Import this module only inside functions that call a kernel, because importing numba takes seconds.
"""

from __future__ import annotations

import numpy as np

from resgrid._internal.jit import inlined, inner, inner_fast, kernel
from resgrid.solvers.elimination_arrays import Fronts, Tree
from resgrid.solvers.elimination_kernels import _column
from resgrid.solvers.scaled import Floats, Integers
from resgrid.solvers.scaled_kernels import NO_EXPONENT, _add_product, _canonical, _shift
from resgrid.solvers.supernodal_factors import add_column

_LEAST, _MOST = 2.0**-300, 2.0**700
"""Smallest and largest magnitude of a sum of doubles in which no term overflows or underflows significantly.

Beyond these limits substitution is repeated with one exponent per number.
"""


@inner_fast
def _product(values: Floats, column: int, x: Floats, begin: int, end: int) -> float:
    """Return the sum of ``values[column + r] * x[r]`` for `r` from `begin` to ``end - 1``."""
    total, c = 0.0, np.uint64(column)
    for each in range(begin, end):
        r = np.uint64(each)
        total += values[c + r] * x[r]
    return total


@kernel
def substitute(tree: Tree, fronts: Fronts, m: Floats, e: Integers) -> None:
    """Solve ``A x = b`` in place, in numbers with separate exponents, ``m * 2**(256 e)``, in the order of elimination.

    `tree, fronts`: elimination tree of a plane of cells, and its factored fronts (dense matrices); `m, e` (cells,):
    mantissas and exponents of ``b``, then of ``x``; ``b`` is nonnegative, and 0 in cells without an equation.

    A front is first computed in doubles with a common exponent, the largest one of its numbers.  If a result among them
    is below 2**-300, or in back substitution above 2**700, terms may have underflowed or overflowed, and the front is
    repeated with one exponent per number.
    """
    buffer = np.empty(fronts.longest)
    for node in range(len(tree.parent)):
        _forward(tree, fronts, node, m, e, buffer)
    for node in range(len(tree.parent) - 1, -1, -1):
        _backward(tree, fronts, node, m, e, buffer)


@kernel
def substitute_plainly(tree: Tree, fronts: Fronts, x: Floats) -> float:
    """Solve ``A x = b`` in place, in doubles; return the smallest value in a cell with an equation.

    The result is infinite if no cell has an equation. `tree, fronts`: elimination tree of a plane of cells, and its
    factored fronts (dense matrices); `x` (cells,): ``b``, then ``x``, in the order of elimination; ``b`` is
    nonnegative, and 0 in cells without an equation.
    """
    buffer, least = np.empty(fronts.longest), np.inf
    for node in range(len(tree.parent)):
        base, row, rows, pivots = tree.offset[node], tree.first_row[node], fronts.rows[node], fronts.pivots[node]
        first = 0
        while first < pivots and x[fronts.cell[row + first]] == 0.0:
            first += 1
        if first == pivots:
            continue
        for r in range(first, rows):
            buffer[r] = x[fronts.cell[row + r]]
        for k in range(first, pivots):
            column = _column(base, rows, k)
            add_column(buffer, k + 1, fronts.values, column + k + 1, buffer[k], rows - k - 1)
            x[fronts.cell[row + k]] = buffer[k] / fronts.values[column + k]
        for r in range(pivots, rows):
            x[fronts.cell[row + r]] = buffer[r]
    for node in range(len(tree.parent) - 1, -1, -1):
        base, row, rows, pivots = tree.offset[node], tree.first_row[node], fronts.rows[node], fronts.pivots[node]
        for r in range(rows):
            buffer[r] = x[fronts.cell[row + r]]
        for k in range(pivots - 1, -1, -1):
            buffer[k] += _product(fronts.values, _column(base, rows, k), buffer, k + 1, rows)
            x[fronts.cell[row + k]] = buffer[k]
            least = min(least, buffer[k])
    return least


@inner
def _align(fronts: Fronts, row: int, begin: int, end: int, m: Floats, e: Integers, buffer: Floats) -> int:
    """Convert the numbers of rows `begin` to ``end - 1`` of a front to doubles ``buffer[r]``; return their exponent.

    The common exponent of the doubles is the largest exponent of the numbers other than 0. `row`: index of the front's
    row 0 in ``fronts.cell``; `m, e` (cells,): mantissas and exponents, by rank of the cell; `buffer` (longest,):
    result.
    """
    common = NO_EXPONENT
    for r in range(begin, end):
        cell = fronts.cell[row + r]
        if m[cell] != 0.0 and e[cell] > common:
            common = int(e[cell])
    for r in range(begin, end):
        cell = fronts.cell[row + r]
        buffer[r] = _shift(m[cell], e[cell] - common)
    return common


@inner
def _forward(tree: Tree, fronts: Fronts, node: int, m: Floats, e: Integers, buffer: Floats) -> None:
    """Distribute the currents into the pivots of a front over its later rows, and divide them by the pivots, in place.

    If a sum in doubles is below 2**-300, all are computed again with one exponent per number. `node`: index of the
    front's node in the tree; `m, e` (cells,): mantissas and exponents of currents, by rank of the cell; `buffer`
    (longest,): work array for one number per row of the front.
    """
    base, row, rows, pivots = tree.offset[node], tree.first_row[node], fronts.rows[node], fronts.pivots[node]
    first = 0
    while first < pivots and m[fronts.cell[row + first]] == 0.0:
        first += 1
    if first == pivots:
        return
    common = _align(fronts, row, first, rows, m, e, buffer)
    for k in range(first, pivots):
        add_column(buffer, k + 1, fronts.values, _column(base, rows, k) + k + 1, buffer[k], rows - k - 1)
    is_plain = True
    for r in range(first, rows):
        is_plain = is_plain and buffer[r] >= _LEAST
    for k in range(first, rows if is_plain else first):
        cell = fronts.cell[row + k]
        m[cell], e[cell] = _canonical(buffer[k], common)
    for k in range(first, pivots if not is_plain else first):
        cell, column = fronts.cell[row + k], _column(base, rows, k)
        for r in range(k + 1, rows):
            _add_fraction(m, e, fronts.cell[row + r], fronts.values[column + r], cell)
    for k in range(first, pivots):
        cell = fronts.cell[row + k]
        m[cell], e[cell] = _canonical(m[cell] / fronts.values[_column(base, rows, k) + k], e[cell])


@inner
def _backward(tree: Tree, fronts: Fronts, node: int, m: Floats, e: Integers, buffer: Floats) -> None:
    """Compute the solution in the pivots' rows of a front from that in its later rows, in place.

    If a value in doubles is below 2**-300 or above 2**700, all are computed again with one exponent per number. `node`:
    index of the front's node in the tree; `m, e` (cells,): mantissas and exponents by rank of the cell: of the solution
    in later rows, and, on entry, of currents divided by pivots in the pivots' rows; `buffer` (longest,): work array for
    one number per row of the front.
    """
    base, row, rows, pivots = tree.offset[node], tree.first_row[node], fronts.rows[node], fronts.pivots[node]
    common, is_plain = _align(fronts, row, 0, rows, m, e, buffer), True
    if common == NO_EXPONENT:
        return
    for k in range(pivots - 1, -1, -1):
        buffer[k] += _product(fronts.values, _column(base, rows, k), buffer, k + 1, rows)
        is_plain = is_plain and _LEAST <= buffer[k] <= _MOST
    for k in range(pivots - 1, -1, -1):
        cell, column = fronts.cell[row + k], _column(base, rows, k)
        if is_plain:
            m[cell], e[cell] = _canonical(buffer[k], common)
        else:
            for r in range(k + 1, rows):
                _add_fraction(m, e, cell, fronts.values[column + r], fronts.cell[row + r])


@inlined
def _add_fraction(m: Floats, e: Integers, to: int, fraction: float, of: int) -> None:
    """Add ``fraction`` times number ``of`` to number ``to``, in place; numbers are ``m[k] * 2**(256 e[k])``."""
    value, scale = _add_product(m[to], e[to], fraction, m[of], e[of])
    m[to], e[to] = _canonical(value, scale)
