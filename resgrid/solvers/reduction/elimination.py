"""Elimination of nodes with at most two neighbours: series resistors, dead ends, rings and what they leave.

Corridors one or two cells wide, trees and chains vanish altogether; of other circuits a core is left, a nodal system of
its own.  Everything is a sum, product or quotient of positive numbers in double-double, so that no accuracy depends on
how the conductances differ: a chain of 1e12 S grounded through 1e-12 S keeps all its digits.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from resgrid.solvers.connections import count_connections
from resgrid.solvers.laplacian import Laplacian
from resgrid.solvers.rails import Rails, Ties
from resgrid.solvers.reduction.rows import Elimination, eliminate_rows

if TYPE_CHECKING:
    from resgrid.solvers.reduction.kernels import Record

_CORRIDOR = 3.1
_FEW = 0.12
_SMALL = 1000
_LARGEST, _SMALLEST = 2.0**300, 2.0**-300


@dataclass(frozen=True, eq=False)
class Reduction:
    """What is left of a nodal laplacian.

    `core`: the rows that are left, as a system without a map of cells; None where nothing is left; `kept` (core rows,):
    rows of the whole that the core holds; `record`: how the others were eliminated; `count`: how many were.
    """

    core: Laplacian | None
    kept: NDArray[np.int64]
    record: Record
    count: int


def may_reduce(laplacian: Laplacian) -> bool:
    """Tell cheaply whether elimination may take a fair share of the rows.

    It may where one row in eight has at most two neighbours, or where there are about three neighbours a row as in
    corridors two cells wide; and only within the range of conductances that products of them can bear.
    """
    n = laplacian.size
    found = count_connections(laplacian)
    if not n or found.entries >= 2**31:
        return False
    if found.entries > _CORRIDOR * n and n > _SMALL and found.few < _FEW * n:
        return False
    return found.largest < _LARGEST and found.smallest > _SMALLEST


def reduce_system(laplacian: Laplacian) -> Reduction:
    """Eliminate every row that has, or comes to have, at most two neighbours."""
    shrunk = eliminate_rows(laplacian.edges, laplacian.ground)
    core = _core(laplacian, shrunk) if len(shrunk.kept) else None
    return Reduction(core, shrunk.kept, shrunk.record, len(shrunk.record.rows))


def _core(laplacian: Laplacian, shrunk: Elimination) -> Laplacian:
    """What is left, in double precision."""
    passed_on = partial(_passed_on, shrunk.record, shrunk.kept)
    rails = laplacian.rails
    return Laplacian(
        shrunk.excess,
        compressed=shrunk.coupling,
        dimensions=laplacian.dimensions,
        rails=rails and replace(rails, ties=partial(_ties_passed_on, rails, passed_on)),
    )


def _passed_on(record: Record, kept: NDArray[np.int64], currents: NDArray[np.float64]) -> NDArray[np.float64]:
    from resgrid.solvers.reduction import kernels

    carried = currents.copy()
    kernels.forward(record, len(record.rows), carried)
    return carried[kept]


def _ties_passed_on(rails: Rails, passed_on: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> Ties:
    return passed_on(rails.to_high), passed_on(rails.to_low)
