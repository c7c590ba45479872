"""Supernodal factors ``L D L^T``, and the solution of equations by forward and back substitution with them.

Numbers are ``m * 2**(256 e)`` (`resgrid.solvers.scaled_kernels`), so that no solution underflows or overflows.  The
factors are computed in `resgrid.solvers.supernodal`.

Loops over an empty range replace branches around loops: numba removes the counts of references to arrays only from
functions without such branches, and the counts took a quarter of the time in mazes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from resgrid._internal.jit import ZERO, inlined, inner_fast, kernel
from resgrid.solvers.laplacian import Graph
from resgrid.solvers.scaled import Floats, Indices, Integers, Numbers, unscaled
from resgrid.solvers.scaled_kernels import NO_EXPONENT, _add_product, _canonical, _shift
from resgrid.solvers.symbolic import Supernodes, Symbolic

_LEAST, _MOST = 2.0**-300, 2.0**700
"""Smallest and largest magnitude of a sum of doubles in which no term overflows or underflows significantly.

Beyond these limits substitution is repeated with one exponent per number.
"""


class SupernodalFactors(NamedTuple):
    """Factors ``L D L^T`` of a matrix with ``n`` rows, and their elimination order.

    `symbolic`: elimination order and sparsity pattern; `matrix`: the factored matrix, in siemens; `values` (entries,):
    entries of ``-L``, supernode by supernode and column by column. An entry below the diagonal is the fraction of a
    current into its column that elimination passes on to its row; entries above the diagonal are 0. `pivot` (n,):
    diagonal of ``D``, in siemens, in elimination order; `largest`: largest diagonal entry of the matrix, in siemens.
    """

    symbolic: Symbolic
    matrix: Graph
    values: Floats
    pivot: Floats
    largest: float

    def substitute(self, m: Floats, e: Integers) -> Numbers:
        """Return the solution of ``A x = b``, by forward and back substitution, in numbers with separate exponents.

        `m, e` (n,): mantissas and exponents of ``b = m * 2**(256 e)``, which are not modified. Returns mantissas and
        exponents of ``x``, (n,) each.
        """
        by = self.symbolic
        x, exponent, column = m.take(by.order), e.take(by.order), np.empty(by.lengths.max(initial=0))
        substitute(self, x, exponent, column)
        return x.take(by.place), exponent.take(by.place)

    def solve(self, rhs: Floats) -> Floats:
        """Return ``x`` (n,), in volts, of ``A x = rhs``; every entry is accurate if ``rhs`` (n,) is nonnegative."""
        m, e = self.substitute(rhs, np.zeros(len(rhs), dtype=np.int64))
        return unscaled(m, e)


@kernel
def substitute(factors: SupernodalFactors, m: Floats, e: Integers, column: Floats) -> None:
    """Solve ``A x = b`` in place, in numbers with separate exponents, ``m * 2**(256 e)``.

    Rows that odd-even reduction has eliminated are reduced first and restored last; ``L D L^T x = b`` is solved for the
    others in between. A supernode is first computed in doubles with a common exponent, the largest one of its numbers.
    If a result among them is below 2**-300 in magnitude, or in back substitution above 2**700, terms may have
    underflowed or overflowed, and the supernode is repeated with one exponent per number.

    `m, e` (n,): mantissas and exponents of ``b``, then of ``x``, in elimination order; `column` (rows of the longest
    supernode,): work array.
    """
    (order, place, nodes), (indptr, indices, edges, _), values, pivot, _ = factors
    n, kept = len(order), nodes.first[-1]
    for k in range(n):
        m[k], e[k] = _canonical(m[k], e[k])
    for k in range(kept, n):
        for entry in range(indptr[order[k]], indptr[order[k] + 1]):
            _add_fraction(m, e, place[indices[entry]], edges[entry] / pivot[k], k)
    for node in range(len(nodes.first) - 1):
        _forward(nodes, values, m, e, column, node)
    for k in range(n):
        m[k], e[k] = _canonical(m[k] / pivot[k], e[k])
    for node in range(len(nodes.first) - 2, -1, -1):
        common, plain = _backward(nodes, values, m, e, column, node)
        _store(nodes, values, m, e, column, node, common, plain)
    for k in range(kept, n):
        for entry in range(indptr[order[k]], indptr[order[k] + 1]):
            _add_fraction(m, e, k, edges[entry] / pivot[k], place[indices[entry]])


@inlined
def _add_fraction(m: Floats, e: Integers, to: int, fraction: float, of: int) -> None:
    """Add ``fraction`` times number ``of`` to number ``to``, in place; numbers are ``m[k] * 2**(256 e[k])``."""
    value, scale = _add_product(m[to], e[to], fraction, m[of], e[of])
    m[to], e[to] = _canonical(value, scale)


@inlined
def _forward(nodes: Supernodes, values: Floats, m: Floats, e: Integers, column: Floats, node: int) -> None:
    """Forward substitution in supernode ``node``: distribute the currents into its columns over its rows, in place.

    If a sum in doubles is below 2**-300 in magnitude, all are computed again with one exponent per number. `nodes`:
    supernodes of ``L``; `values`: entries of ``-L``; `m, e` (n,): mantissas and exponents of currents ``m * 2**(256
    e)``; `column`: work array.
    """
    begin, base, first = nodes.start[node], nodes.offset[node], nodes.first[node]
    length, columns = nodes.start[node + 1] - begin, nodes.first[node + 1] - first
    first_nonzero = 0
    while first_nonzero < columns and m[first + first_nonzero] == 0.0:
        first_nonzero += 1
    end = length if first_nonzero < columns else first_nonzero
    common, plain = _align(nodes.rows, begin, first_nonzero, end, m, e, column), True
    for c in range(first_nonzero, columns):
        add_column(column, c + 1, values, base + c * length + c + 1, column[c], length - c - 1)
    for r in range(first_nonzero, end):
        plain = plain and abs(column[r]) >= _LEAST
    for r in range(first_nonzero, end if plain else first_nonzero):
        row = nodes.rows[begin + r]
        m[row], e[row] = _canonical(column[r], common)
    for c in range(columns if plain else first_nonzero, columns):
        for r in range(c + 1, length):
            _add_fraction(m, e, nodes.rows[begin + r], values[base + c * length + r], first + c)


@inlined
def _backward(nodes: Supernodes, values: Floats, m: Floats, e: Integers, column: Floats, node: int) -> tuple[int, bool]:
    """Back substitution in supernode ``node``: compute the values of its columns from those of later rows.

    `nodes`: supernodes of ``L``; `values`: entries of ``-L``; `m, e` (n,): mantissas and exponents of the solution ``m
    * 2**(256 e)``, not modified; `column`: work array, whose first entries become the values of the columns, as doubles
    ``v``. Returns the common exponent ``e`` of these values ``v * 2**(256 e)``, and whether all ``v`` have magnitudes
    between 2**-300 and 2**700. If not, terms may have underflowed or overflowed, and the doubles must not be used.
    """
    begin, base = nodes.start[node], nodes.offset[node]
    length, columns = nodes.start[node + 1] - begin, nodes.first[node + 1] - nodes.first[node]
    common = _align(nodes.rows, begin, ZERO, length, m, e, column)
    plain = True
    for c in range(columns - 1, -1, -1):
        column[c] += _product(column, values, base + c * length, c + 1, length)
        plain = plain and _LEAST <= abs(column[c]) <= _MOST
    return common, plain


@inlined
def _store(
    nodes: Supernodes, values: Floats, m: Floats, e: Integers, column: Floats, node: int, common: int, plain: bool
) -> None:
    """Write the values of the columns of supernode ``node`` into the solution ``m, e`` (n,), in place.

    `column`, `common`: the values ``column[c] * 2**(256 common)`` of the columns; `plain`: whether these doubles are
    free of underflow and overflow (magnitudes of 2**-300 to 2**700). If not, the values are computed again, with one
    exponent per number. `nodes`, `values`: supernodes of ``L`` and entries of ``-L``.
    """
    begin, base, first = nodes.start[node], nodes.offset[node], nodes.first[node]
    length, columns = nodes.start[node + 1] - begin, nodes.first[node + 1] - first
    for c in range(columns if plain else 0):
        m[first + c], e[first + c] = _canonical(column[c], common)
    for c in range(-1 if plain else columns - 1, -1, -1):
        for r in range(c + 1, length):
            _add_fraction(m, e, first + c, values[base + c * length + r], nodes.rows[begin + r])


@inlined
def _align(rows: Indices, begin: int, skipped: int, length: int, m: Floats, e: Integers, column: Floats) -> int:
    """Convert the numbers of rows ``rows[begin + r]`` to doubles ``column[r]``; return their common exponent.

    `r` runs from ``skipped`` to ``length - 1``; numbers are ``m * 2**(256 e)``; the common exponent is the largest one
    of a number other than 0.
    """
    common = NO_EXPONENT
    for r in range(skipped, length):
        row = rows[begin + r]
        if m[row] != 0.0 and e[row] > common:
            common = int(e[row])
    for r in range(skipped, length):
        row = rows[begin + r]
        column[r] = _shift(m[row], e[row] - common)
    return common


@inner_fast
def add_column(target: Floats, there: int, source: Floats, here: int, weight: float, count: int) -> None:
    """Add ``weight * source[here + i]`` to ``target[there + i]`` for all ``i < count``."""
    t, s = np.uint64(there), np.uint64(here)
    for each in range(count):
        i = np.uint64(each)
        target[t + i] += weight * source[s + i]


@inner_fast
def _product(column: Floats, values: Floats, base: int, begin: int, end: int) -> float:
    """Return the inner product of ``column[begin:end]`` and ``values[base + begin:base + end]``."""
    total, b = 0.0, np.uint64(base)
    for each in range(begin, end):
        i = np.uint64(each)
        total += column[i] * values[b + i]
    return total
