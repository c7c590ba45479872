"""Compiled kernels of the elimination tree: elimination of fronts, and comparison of new with stored equations.

The comparison finds the nodes of the tree that must be eliminated again.  The tree and its arrays are described in
`resgrid.solvers.elimination_arrays`.  A front is a dense symmetric matrix of the conductances between the cells of one
node of the tree and the later cells connected to them.  Its lower triangle is stored by columns; a diagonal entry holds
the pivot after the elimination.  Conductances to the ground (nodes of known voltage) have an array of their own.

Import this module only inside functions that call a kernel, because importing numba takes seconds.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.jit import inlined, inner, inner_fast, kernel
from resgrid.solvers.elimination_arrays import Fronts, Planes, Tree
from resgrid.solvers.supernodal import range_sum
from resgrid.solvers.supernodal_factors import add_column

_PANEL = 8
"""Number of columns of a front that are eliminated before the other columns are updated."""

_FEW = 2
"""Largest number of pivots for which the elimination of a front skips the zeros of its columns.

The fronts of leaves of the tree skip the zeros for any number of pivots.
"""

_SMALLEST = 1e-300
"""Value above which a pivot (a sum of conductances, in their unit) is valid, because its inverse does not overflow."""

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@kernel
def load(tree: Tree, planes: Planes, across: Floats, along: Floats, ground: Floats, cell_is_active: Bools) -> int:
    """Store the equations of all cells, mark the nodes of the tree to be eliminated again, and return their number.

    `tree`: elimination tree; `planes`: the stored equations and the marks of nodes, updated; `across` (nx + 1, ny),
    `along` (nx, ny + 1): conductances through the faces across the first and the second axis, 0 next to a cell without
    an equation; index ``(i, j)`` is the lower face of cell ``(i, j)``. `ground`, `cell_is_active` (nx, ny): conductance
    to the ground (nodes of known voltage), and mask of the cells with an equation.  A node is marked if the equation of
    one of its cells differs from the stored one, or if a child is marked.
    """
    own = np.empty(4)
    for i in range(ground.shape[0]):
        for j in range(ground.shape[1]):
            cell = tree.rank[i, j]
            own[0], own[1], own[2], own[3] = across[i, j], across[i + 1, j], along[i, j], along[i, j + 1]
            differs = cell_is_active[i, j] != planes.is_active[cell] or ground[i, j] != planes.ground[cell]
            for side in range(4):
                differs |= own[side] != planes.conductance[cell, side]
            if not differs:
                continue
            planes.is_active[cell], planes.ground[cell] = cell_is_active[i, j], ground[i, j]
            planes.is_marked[tree.owner[cell]] = True
            for side in range(4):
                planes.conductance[cell, side] = own[side]
    marked = 0
    for node in range(len(tree.parent)):
        if planes.is_marked[node]:
            marked += 1
            if tree.parent[node] >= 0:
                planes.is_marked[tree.parent[node]] = True
    return marked


@kernel
def eliminate(tree: Tree, planes: Planes, fronts: Fronts, begin: int, end: int) -> bool:
    """Eliminate the marked nodes `begin` to ``end - 1`` of the tree; return whether all pivots are valid.

    Pivots are sums of conductances, never differences (Grassmann, Taksar & Heyman 1985).  A valid pivot is finite and
    above `_SMALLEST`; the first invalid pivot ends the elimination.  Marks are removed from the eliminated nodes.
    `tree`: elimination tree; `planes`: equations of the cells, and marks of the nodes; `fronts`: receives the fronts of
    the eliminated nodes.
    """
    place, panel = np.empty(len(planes.ground), np.int32), np.empty(_PANEL * fronts.longest)
    at, weights = np.empty(fronts.longest, np.int64), np.zeros((4, _PANEL))
    for node in range(begin, end):
        if not planes.is_marked[node]:
            continue
        _list_rows(tree, planes, fronts, node)
        base, row, rows = tree.offset[node], tree.first_row[node], fronts.rows[node]
        for entry in range(base, base + rows * (rows + 1) // 2):
            fronts.values[np.uint64(entry)] = 0.0
        for r in range(rows):
            place[fronts.cell[row + r]] = r
            fronts.ground[row + r] = 0.0
        _add_own(tree, planes, fronts, node, place)
        if tree.left[node] >= 0:
            _add_child(tree, fronts, tree.left[node], node, place, at)
            _add_child(tree, fronts, tree.right[node], node, place, at)
        if tree.left[node] < 0 or fronts.pivots[node] <= _FEW:
            is_valid = _eliminate_sparse(tree, fronts, node, at)
        else:
            is_valid = _eliminate_dense(tree, fronts, node, panel, weights)
        if not is_valid:
            return False
        planes.is_marked[node] = False
    return True


@inlined
def _column(base: int, rows: int, column: int) -> int:
    """Return the index into ``fronts.values`` at which row 0 of a column of a front would be stored.

    Row ``r >= column`` of the column is stored at this index plus ``r``. `base`: index of the first value of the front;
    `rows`: number of rows of the front; `column`: number of the column in the front, from 0.
    """
    return base + column * rows - column * (column - 1) // 2 - column


@inner
def _list_rows(tree: Tree, planes: Planes, fronts: Fronts, node: int) -> None:
    """List the cells of the front of a node in ``fronts.cell``: its pivots, then later cells connected to them.

    Cells are in the order of elimination. Later cells are those that the fronts of the node's children contain, and the
    neighbours of the pivots; the children are eliminated already. The numbers of pivots and of rows are written, too.
    `node`: index of the node in the tree.
    """
    row, end, cell = tree.first_row[node], tree.last[node], fronts.cell
    pivots = 0
    for rank in range(tree.first[node], end):
        if planes.is_active[rank]:
            cell[row + pivots] = rank
            pivots += 1
    rows = pivots
    left, right = tree.left[node], tree.right[node]
    if left >= 0:
        i, last_i = tree.first_row[left] + fronts.pivots[left], tree.first_row[left] + fronts.rows[left]
        j, last_j = tree.first_row[right] + fronts.pivots[right], tree.first_row[right] + fronts.rows[right]
        while i < last_i and cell[i] < end:
            i += 1
        while j < last_j and cell[j] < end:
            j += 1
        while i < last_i or j < last_j:
            of_left = j >= last_j or (i < last_i and cell[i] <= cell[j])
            of_right = i >= last_i or (j < last_j and cell[j] <= cell[i])
            cell[row + rows] = cell[i] if of_left else cell[j]
            rows += 1
            i += of_left
            j += of_right
    for k in range(pivots):
        for side in range(4):
            other = tree.neighbour[cell[row + k], side]
            if other < end or planes.conductance[cell[row + k], side] == 0.0:
                continue
            at = rows
            while at > pivots and cell[row + at - 1] > other:
                at -= 1
            if at > pivots and cell[row + at - 1] == other:
                continue
            for r in range(rows, at, -1):
                cell[row + r] = cell[row + r - 1]
            cell[row + at] = other
            rows += 1
    fronts.pivots[node], fronts.rows[node] = pivots, rows


@inlined
def _add_own(tree: Tree, planes: Planes, fronts: Fronts, node: int, place: NDArray[np.int32]) -> None:
    """Add the conductances from the pivots of a node to later cells, and those to the ground, to the node's front.

    `node`: index of the node in the tree; `place` (cells,): row of every cell of the front, by rank of the cell.
    """
    base, row, rows = tree.offset[node], tree.first_row[node], fronts.rows[node]
    for k in range(fronts.pivots[node]):
        rank, column = fronts.cell[row + k], _column(base, rows, k)
        fronts.ground[row + k] = planes.ground[rank]
        for side in range(4):
            other = tree.neighbour[rank, side]
            if other > rank and planes.conductance[rank, side] > 0.0:
                fronts.values[column + place[other]] += planes.conductance[rank, side]


@inner
def _add_child(tree: Tree, fronts: Fronts, child: int, node: int, place: NDArray[np.int32], at: Integers) -> None:
    """Add the conductances between the remaining cells of a child, after its elimination, to the front of its parent.

    The conductances to the ground are added, too.  `child, node`: indices of the child and of its parent in the tree;
    `place` (cells,): row of every cell of the parent's front; `at` (longest,): work array, receives the rows of the
    child's remaining cells in the parent's front.  Both fronts list cells in the order of elimination; runs of cells
    that are consecutive in both are added by one loop.
    """
    values, row, base, rows = fronts.values, tree.first_row[node], tree.offset[node], fronts.rows[node]
    pivots = fronts.pivots[child]
    left = fronts.rows[child] - pivots
    child_row = tree.first_row[child] + pivots
    for i in range(left):
        at[i] = place[fronts.cell[child_row + i]]
        fronts.ground[row + at[i]] += fronts.ground[child_row + i]
    for i in range(left):
        target = _column(base, rows, at[i])
        source = _column(tree.offset[child], fronts.rows[child], pivots + i) + pivots
        r = i + 1
        while r < left:
            stop = r + 1
            while stop < left and at[stop] == at[stop - 1] + 1:
                stop += 1
            shift = target + at[r] - r
            for s in range(r, stop):
                values[np.uint64(shift + s)] += values[np.uint64(source + s)]
            r = stop


@inner
def _eliminate_sparse(tree: Tree, fronts: Fronts, node: int, nonzero: Integers) -> bool:
    """Eliminate the pivots of a front one by one, for columns with many zeros; return whether all pivots are valid.

    A valid pivot is finite and above `_SMALLEST`. `node`: node of the tree whose front it is; `nonzero` (longest,):
    work array for the rows of the nonzero entries of a column.
    """
    values, ground, row, base = fronts.values, fronts.ground, tree.first_row[node], tree.offset[node]
    rows = fronts.rows[node]
    for k in range(fronts.pivots[node]):
        column, count, pivot = _column(base, rows, k), 0, ground[row + k]
        for r in range(k + 1, rows):
            if values[column + r] != 0.0:
                nonzero[count] = r
                count += 1
                pivot += values[column + r]
        if not (pivot > _SMALLEST and math.isfinite(pivot)):
            return False
        inverse = 1.0 / pivot
        values[column + k] = pivot
        ground[row + k] *= inverse
        for a in range(count):
            r = nonzero[a]
            ground[row + r] += values[column + r] * ground[row + k]
            values[column + r] *= inverse
        for a in range(count - 1):
            weight, target = pivot * values[column + nonzero[a]], _column(base, rows, nonzero[a])
            for b in range(a + 1, count):
                values[target + nonzero[b]] += weight * values[column + nonzero[b]]
    return True


@inner
def _eliminate_dense(tree: Tree, fronts: Fronts, node: int, panel: Floats, weights: Floats) -> bool:
    """Eliminate the pivots of a front in panels of `_PANEL` columns; return whether all pivots are valid.

    A valid pivot is finite and above `_SMALLEST`. `node`: node of the tree whose front it is; `panel` (columns of a
    panel times rows,), `weights` (4, columns of a panel): work arrays.
    """
    values, ground, row, base = fronts.values, fronts.ground, tree.first_row[node], tree.offset[node]
    pivots, rows = fronts.pivots[node], fronts.rows[node]
    first = 0
    while first < pivots:
        stop = min(first + _PANEL, pivots)
        for k in range(first, stop):
            column = _column(base, rows, k)
            for j in range(first, k):
                fraction = panel[(j - first) * rows + k]
                weight = values[_column(base, rows, j) + j] * fraction
                if weight != 0.0:
                    ground[row + k] += weight * ground[row + j]
                    add_column(values, column + k + 1, panel, (j - first) * rows + k + 1, weight, rows - k - 1)
            pivot = ground[row + k] + range_sum(values, column + k + 1, column + rows)
            if not (pivot > _SMALLEST and math.isfinite(pivot)):
                return False
            values[column + k] = pivot
            ground[row + k] /= pivot
            _divide(values, column, panel, (k - first) * rows, pivot, k + 1, rows)
        for k in range(stop - first, _PANEL):
            panel[k * rows + stop : (k + 1) * rows] = 0.0
        _update_columns(tree, fronts, node, panel, weights, first, stop)
        first = stop
    return True


@inlined
def _update_columns(
    tree: Tree, fronts: Fronts, node: int, panel: Floats, weights: Floats, first: int, stop: int
) -> None:
    """Add the contributions of the eliminated columns `first` to ``stop - 1`` to all later columns, two at a time.

    `node`: index of the node in the tree whose front is updated; `panel`: entries of these columns divided by pivots,
    column by column, filled with zeros to the width of a panel; `weights` (4, columns of a panel): work array for two
    sets of weights, the pivots, and their conductances to the ground divided by the pivots.
    """
    values, ground, row, base = fronts.values, fronts.ground, tree.first_row[node], tree.offset[node]
    rows = fronts.rows[node]
    weights[2:] = 0.0
    for k in range(first, stop):
        weights[2, k - first], weights[3, k - first] = values[_column(base, rows, k) + k], ground[row + k]
    for r in range(stop, rows - 1, 2):
        between = to_one = to_other = 0.0
        for k in range(_PANEL):
            fraction = panel[k * rows + r + 1]
            weights[0, k], weights[1, k] = weights[2, k] * panel[k * rows + r], weights[2, k] * fraction
            between += weights[0, k] * fraction
            to_one += weights[0, k] * weights[3, k]
            to_other += weights[1, k] * weights[3, k]
        ground[row + r] += to_one
        ground[row + r + 1] += to_other
        one, other = _column(base, rows, r) + r + 2, _column(base, rows, r + 1) + r + 2
        values[one - 1] += between
        _add_panel(values, one, other, panel, rows, r + 2, weights, rows - r - 2)
    if (rows - stop) % 2:
        for k in range(_PANEL):
            ground[row + rows - 1] += weights[2, k] * panel[k * rows + rows - 1] * weights[3, k]


@inner_fast
def _add_panel(
    values: Floats, one: int, other: int, panel: Floats, apart: int, begin: int, weights: Floats, count: int
) -> None:
    """Add two weighted sums of a panel's columns to `count` entries of `values` from `one` on, and from `other` on.

    `panel`: entries divided by pivots, column by column; `apart`: number of entries from the begin of a column to the
    next; `begin`: first row that is summed; `weights` (4, columns of a panel): weights of the columns, in row 0 for the
    sum at `one` and in row 1 for the sum at `other`; rows 2 and 3 are ignored.
    """
    u, v = np.uint64(one), np.uint64(other)
    a, b = np.uint64(begin), np.uint64(begin + apart)
    c, d = np.uint64(begin + 2 * apart), np.uint64(begin + 3 * apart)
    e, f = np.uint64(begin + 4 * apart), np.uint64(begin + 5 * apart)
    g, h = np.uint64(begin + 6 * apart), np.uint64(begin + 7 * apart)
    p, q = weights[0], weights[1]
    p0, p1, p2, p3, p4, p5, p6, p7 = p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7]
    q0, q1, q2, q3, q4, q5, q6, q7 = q[0], q[1], q[2], q[3], q[4], q[5], q[6], q[7]
    for each in range(count):
        i = np.uint64(each)
        w0, w1, w2, w3 = panel[a + i], panel[b + i], panel[c + i], panel[d + i]
        w4, w5, w6, w7 = panel[e + i], panel[f + i], panel[g + i], panel[h + i]
        values[u + i] += ((p0 * w0 + p1 * w1) + (p2 * w2 + p3 * w3)) + ((p4 * w4 + p5 * w5) + (p6 * w6 + p7 * w7))
        values[v + i] += ((q0 * w0 + q1 * w1) + (q2 * w2 + q3 * w3)) + ((q4 * w4 + q5 * w5) + (q6 * w6 + q7 * w7))


@inner_fast
def _divide(values: Floats, column: int, panel: Floats, there: int, pivot: float, begin: int, end: int) -> None:
    """Divide ``values[column + r]`` by `pivot` in place, and copy the quotients to ``panel[there + r]``.

    `r` runs from `begin` to ``end - 1``.
    """
    inverse, c, t = 1.0 / pivot, np.uint64(column), np.uint64(there)
    for each in range(begin, end):
        r = np.uint64(each)
        fraction = values[c + r] * inverse
        values[c + r] = fraction
        panel[t + r] = fraction
