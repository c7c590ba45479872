"""What a potential will be like, from coarse to fine: nested iteration, in which all numbers stay positive.

On a level that is small the equations are solved directly.  Then, level by level, the answer is spread over the blocks,
relaxed a few times, and taken as the height that the next finer level is graded by, whose equations some iterations
solve well enough.  Coarse networks know length, so that the decades by which a potential falls differ by some per cent
from level to level only.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from resgrid.nodal.multigrid import grade_kernels
from resgrid.nodal.multigrid.board_iteration import iterate_on_board
from resgrid.nodal.multigrid.boards import Level, to_graph
from resgrid.nodal.multigrid.graded import Gradable
from resgrid.nodal.multigrid.part import Part, surroundings
from resgrid.nodal.multigrid.place_kernels import put_at_places, take_from_places
from resgrid.nodal.superlu import symmetric_factors
from resgrid.nodal.watch import Watch

_SMALL = 4000
"""Nodes up to which a level is solved directly."""

_SWEEPS = 3
_ENOUGH = 1e-5
"""Residual to which coarse levels are solved."""

FEW = 10_000
"""Nodes whose equations are solved directly, at most, where iterations go astray."""


def foresee(levels: Gradable, currents: NDArray[np.float64]) -> NDArray[np.float64]:
    """About what the potential will be.

    Parameters
    ----------
    levels : Gradable
    currents : ndarray of float64, shape (2, places)
        Into the places of the first level, none negative.

    Returns
    -------
    ndarray of float64, shape (2, places)
        Positive wherever there is an unknown.

    Raises
    ------
    AccuracyError
        If rounding leaves no pivot on the small level.
    """
    below, into = levels.below(), _summed(levels, currents)
    if below.level.size <= _SMALL or not below.steps:
        coarse = _solved(below.level, into)
    else:
        coarse = _potential(below, into, foresee(below, into))
    return _spread(levels, coarse, currents)


def _summed(levels: Gradable, currents: NDArray[np.float64]) -> NDArray[np.float64]:
    """Currents into the blocks."""
    step, fed = levels.steps[0], np.flatnonzero(currents != 0.0)
    target = step.whole_target.ravel()[fed]
    summed = np.bincount(target, currents.ravel()[fed], 2 * step.level.lattice.places)
    return np.asarray(summed.reshape(2, -1), dtype=np.float64)


def _solved(level: Level, currents: NDArray[np.float64]) -> NDArray[np.float64]:
    """Potential by sparse factors; positive, for all that they subtract are rounding errors."""
    graph, number = to_graph(level)
    n, used = graph.size, np.flatnonzero(number >= 0)
    coupling = sparse.csr_array((graph.conductance, graph.indices, graph.indptr), shape=(n, n))
    matrix = sparse.diags_array(coupling.sum(axis=1) + graph.leak) - coupling
    potential = np.zeros(number.size)
    potential[used] = symmetric_factors(matrix).solve(currents.ravel()[used])
    return potential.reshape(currents.shape)


def _potential(levels: Gradable, currents: NDArray[np.float64], height: NDArray[np.float64]) -> NDArray[np.float64]:
    """Potential to some tenths of itself, by some iterations on levels in proportion to a height.

    Parameters
    ----------
    levels : Gradable
    currents, height : ndarray of float64, shape (2, places)
        As of `foresee`.

    Returns
    -------
    ndarray of float64, shape (2, places)
        Positive wherever there is an unknown.
    """
    hierarchy = levels.grade(height, stretched=False)
    assert hierarchy.grid is not None
    b, x = take_from_places(levels.place, currents.ravel()), np.zeros_like(currents)
    found = iterate_on_board(hierarchy, hierarchy.grid, b * levels.unit, _ENOUGH, None, Watch())[0]
    put_at_places(levels.place, found, 1.0, x.ravel())
    return mended(levels, currents, x, height)


def mended(
    levels: Gradable, currents: NDArray[np.float64], x: NDArray[np.float64], height: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Solve the equations directly where the way up a potential does not lead to its source, the rest taken as it is.

    Where these are too many, they keep the height that was foreseen.  Returns ``x`` itself where nothing is astray.
    """
    wrong = grade_kernels.astray(levels.first[0], currents, x) & levels.unknown
    places = np.flatnonzero(wrong)
    if not len(places):
        return x
    region = surroundings(places, wrong.size, lambda edge: _joined(levels, edge)[1], FEW)
    if region is None:
        return np.where(wrong, height, x)
    better = x.copy()
    better.ravel()[region] = part_of(levels, region).potential(currents.ravel(), x.ravel())
    return better


def _joined(
    levels: Gradable, places: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Faces and links at some places, red ones first: from which place, to which one, and their conductance."""
    board, count = levels.first[0], levels.level.lattice.places
    red, black = places[places < count], places[places >= count] - count
    here: list[NDArray[np.integer]] = []
    there: list[NDArray[np.integer]] = []
    conductance: list[NDArray[np.floating]] = []
    for face, away in zip(board.faces, board.distance.tolist(), strict=True):
        here += [red, count + black]
        there += [count + red + away, black - away]
        conductance += [face[red], face[black - away]]
    if len(board.links):
        at_red, at_black = np.isin(board.link_red, red), np.isin(board.link_black, black)
        here += [board.link_red[at_red], count + board.link_black[at_black]]
        there += [count + board.link_black[at_red], board.link_red[at_black]]
        conductance += [board.links[at_red], board.links[at_black]]
    a, b, g = (np.concatenate(parts) for parts in (here, there, conductance))
    return a[g > 0.0].astype(np.int64), b[g > 0.0].astype(np.int64), g[g > 0.0]


def part_of(levels: Gradable, places: NDArray[np.int64]) -> Part:
    """The equations of some places, red ones first."""
    board, count = levels.first[0], levels.level.lattice.places
    here, there, g = _joined(levels, places)
    red, black = places[places < count], places[places >= count] - count
    degree = np.concatenate([1.0 / board.red_inverse[red], board.black_degree[black]])
    return Part.of(places, degree, np.searchsorted(places, here), there, g)


def _spread(levels: Gradable, coarse: NDArray[np.float64], currents: NDArray[np.float64]) -> NDArray[np.float64]:
    """Spread a coarse potential over its blocks, and smooth it."""
    x = coarse.ravel()[levels.steps[0].whole_target]
    x[levels.level.degree == 0.0] = 0.0
    grade_kernels.smooth(levels.first[0], currents, x, _SWEEPS)
    return np.asarray(x)
