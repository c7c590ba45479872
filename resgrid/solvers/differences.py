"""Differences between rows, right where the voltages themselves differ by less than a double can tell.

Substitution is done in differences between the rows that elimination joins, each of them a sum of products
(`resgrid.solvers.column_kernels.substitute_differences`): stiff ties, flat dead ends and loops keep their currents.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from resgrid.solvers.selected_inverse import columns_of
from resgrid.solvers.supernodal import SupernodalFactors

if TYPE_CHECKING:
    from resgrid.solvers.column_kernels import Columns, Gaps


@dataclass(frozen=True, eq=False)
class Differences:
    """Factors by columns, with the rails as nodes of their own.

    `columns`: of ``-L`` and ``D``; `order` (n,): the row that is eliminated at every place; `ties` (n, rails): what
    joins a row to each rail when it is eliminated, in siemens.
    """

    columns: Columns
    order: NDArray[np.int64]
    ties: NDArray[np.float64]

    def solve(self, fed: NDArray[np.float64], volts: NDArray[np.float64]) -> Gaps:
        """Solve for what is fed into the rows (n,), in amperes, and the rails' voltages (rails,)."""
        from resgrid.solvers.column_kernels import Gaps, feed_forward, substitute_differences

        n, entries = len(self.order), len(self.columns.rows)
        carried = np.stack([fed, np.abs(fed)], axis=1)[self.order]
        feed_forward(self.columns, carried)
        (change, change_low), (apart, apart_low) = np.zeros((2, n)), np.zeros((2, entries))
        above, above_low = np.zeros((2, n, len(volts)))
        gaps = Gaps(change, change_low, apart, apart_low, above, above_low)
        substitute_differences(self.columns, carried, self.ties, volts, gaps, given=False)
        return gaps

    def correct(self, gaps: Gaps, more: Gaps, volts: NDArray[np.float64]) -> None:
        """Add the changes of other gaps, in place."""
        from resgrid.solvers.column_kernels import substitute_differences
        from resgrid.solvers.refine_kernels import corrected

        corrected(gaps.change.copy(), gaps.change_low.copy(), more.change, gaps.change, gaps.change_low)
        substitute_differences(self.columns, np.zeros((len(self.order), 2)), self.ties, volts, gaps, given=True)

    def places(self, rows: NDArray[np.int32]) -> NDArray[np.int32]:
        """Where rows are in the order of elimination, shape of ``rows``; -1 for a row of -1."""
        place = np.full(len(self.order) + 1, -1, dtype=np.int32)
        place[self.order] = np.arange(len(self.order), dtype=np.int32)
        return place[rows]

    def falls(
        self, gaps: Gaps, ends: NDArray[np.int32], rail: NDArray[np.int32], lift: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Falls across edges beside their lifts, in double-double.

        Shapes: `ends` (m, 2): places, or -1 for a node of known voltage, `rail, lift` (m,); returns (m,), (m,).
        """
        from resgrid.solvers.column_kernels import add_falls

        falls, falls_low = lift.copy(), np.zeros_like(lift)
        add_falls(self.columns, gaps, ends, rail, falls, falls_low)
        return falls, falls_low

    def heights(self, gaps: Gaps) -> NDArray[np.float64]:
        """Heights of all rows above every rail, in volts, (n, rails)."""
        above = np.empty_like(gaps.above)
        above[self.order] = gaps.above
        return above


def differences(factors: SupernodalFactors, ties: NDArray[np.float64]) -> Differences:
    """Make factors ready for differences.  Shapes: `ties` (n, rails): conductance from every row to every rail."""
    from resgrid.solvers.column_kernels import feed_forward

    order, columns = columns_of(factors)
    carried = ties[order]
    feed_forward(columns, carried)
    return Differences(columns, order, carried)
