"""Choose the direct or the multigrid method for a Laplacian by their estimated costs, and factor the Laplacian.

Costs are seconds on one core of the computer on which ``benchmarks/choice.py`` measured both methods on planes,
volumes, mazes and netlists. That benchmark also measures the loss of the choice against the best method. Only ratios of
costs matter.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from resgrid._internal.memory import require_memory
from resgrid.errors import InputError
from resgrid.solvers.factors import EXACT_ROWS, Factor, factor_direct, factor_multigrid
from resgrid.solvers.laplacian import VOLUME, ConductanceStatistics, Laplacian, conductance_statistics
from resgrid.solvers.threads import SINGLE_THREAD, ThreadTeam

if TYPE_CHECKING:
    from resgrid.solvers.symbolic import Symbolic

METHODS = ("direct", "multigrid")


class Seconds(NamedTuple):
    """Measured costs of the methods, in seconds per row of the matrix unless stated otherwise.

    Pairs are for planes and for volumes (three or more dimensions). A grid is tortuous if its corridors are narrower
    than 20 cells on average, and open otherwise; a graph is sparse below 2.5 cells. Solutions have the accuracy
    "direction" (a small relative error of every entry) unless stated otherwise.

    `corridor, across`: direct solution along corridors of width ``w`` cells, ``corridor + across * w**2``; `row`:
    direct solution, without the time for entries of the factors; `exact_row`: value that replaces `row` if voltages are
    refined to the nearest doubles; `entry, product`: seconds per entry of the factors, and per multiplication of the
    factorization; `order`: ordering by minimum fill; `levels`: setup of multigrid, in seconds per solve; `open,
    tortuous`: multigrid solution on an open and on a tortuous grid between two rails; `decade`: increase of `open` and
    `tortuous` per order of magnitude by which the potential falls; `driven, driven_tortuous, driven_sparse,
    driven_netlist`: multigrid solution with a single rail and current sources, on open grids, tortuous grids, sparse
    graphs and netlists other than grids; `netlist, netlist_decade`: multigrid solution between two rails on a netlist
    other than a grid, and increase per order of magnitude; `normwise`: multigrid solution of normwise accuracy.
    """

    corridor: tuple[float, float] = (0.5e-6, 0.7e-6)
    across: tuple[float, float] = (0.7e-9, 9e-9)
    row: float = 0.3e-6
    exact_row: float = 0.65e-6
    entry: float = 6e-9
    product: float = 0.065e-9
    order: float = 2e-6
    levels: float = 4e-3
    open: float = 0.33e-6
    tortuous: float = 0.7e-6
    decade: tuple[float, float] = (0.02e-6, 0.012e-6)
    driven: float = 0.5e-6
    driven_tortuous: float = 0.9e-6
    driven_sparse: float = 4e-6
    driven_netlist: float = 1.6e-6
    netlist: float = 4e-6
    netlist_decade: float = 0.04e-6
    normwise: float = 0.45e-6


SECONDS = Seconds()

OPEN_WIDTH = 20.0
"""Smallest mean width of corridors, in cells, for which multigrid converges as fast as in open space.

A corridor is a strip of nodes between obstacles or borders of the grid.
"""

SPARSE_WIDTH = 2.5
"""Mean width of corridors, in cells, below which multigrid takes longest.

A corridor is a strip of nodes between obstacles or borders of the grid. Below this width a graph consists of chains and
trees: on a plane, rows have fewer than 3.2 neighbours on average.
"""


class MethodChoice(NamedTuple):
    """The chosen method, with the statistics and the ordering computed while choosing.

    `laplacian`: the matrix, with compressed rows if the method or the choice needs them; `accuracy`: "direction" for a
    small relative error of every entry, or "normwise"; `statistics`: statistics of the conductances; `method`: "direct"
    or "multigrid"; `order`: elimination order of the direct method, None if it is still to be computed (or for
    multigrid).
    """

    laplacian: Laplacian
    accuracy: str
    statistics: ConductanceStatistics
    method: str
    order: Symbolic | None = None

    @property
    def memory(self) -> float:
        """Estimated peak memory in addition to the netlist, in bytes.

        Direct method: the number of entries of the factors is known with an elimination order. Otherwise this number is
        about ``n log n`` for ``n`` rows on planes, ``n**(4/3)`` in three dimensions, ``n**(3/2)`` in four (George & Liu
        1981), with constants measured on open grids, which have the most fill. Multigrid: the assumed memory per row
        and per matrix entry is a tenth above the measured one; grids, which need no compressed rows, and other netlists
        have separate values. The accuracy "direction" also needs compressed rows and numbers with separate exponents.
        """
        laplacian, order, n = self.laplacian, self.order, self.laplacian.size
        if self.method == "multigrid":
            on_nodes, on_entries = (100.0, 12.0) if laplacian.grid is not None else (230.0, 22.0)
            if self.accuracy == "direction":
                on_nodes, on_entries = on_nodes + 60.0, on_entries + 18.0
            if laplacian.rails is not None and laplacian.rails.leak:
                on_nodes += _ON_LEAKS
            return on_nodes * n + on_entries * self.statistics.entries + _ON_LEVELS
        if order is not None:
            return direct_memory(order)
        fill = {2: 2.6 * n * np.log2(n + 2), 3: 10.0 * n ** (4 / 3), 4: 4.5 * n ** (3 / 2)}
        return float(9.0 * fill.get(laplacian.dimensions, 3.0 * n) + _ON_ROWS * n)


_SMALL = 2000
"""Number of rows below which ``"auto"`` chooses the direct method without an estimate, since it is always faster."""

_ROUGH, _ROUGH_VOLUME = 0.25, 0.5
"""Largest fraction of weak conductances, among all between rows, for which multigrid is considered: planes, volumes.

A conductance is weak below a tenth of the strongest conductance at its two ends (`laplacian.WEAK`). A matrix with more
than 4.2 neighbours per row counts as a volume. With more weak conductances multigrid needs too many cycles. The limit
of volumes is higher, since their direct factors cost more.
"""

_EVEN, _CONTRAST = 3.0, 0.4
"""Effect of the range of conductances on the time of multigrid on planes.

The range is the ratio of the largest to the smallest conductance between rows. A range of up to `_EVEN` orders of
magnitude costs no time; each further order multiplies the time by ``10**_CONTRAST``.
"""

_LEAST_DECADES, _MOST_DECADES = 30.0, 250.0
"""Smallest and largest fall of the potential, in orders of magnitude, in the comparison of the methods.

The potential is the voltage difference to the high rail. The first value is assumed for the first comparison, before
the fall is estimated. Beyond the second value, iterative refinement by multigrid takes too long: the direct method is
used without a comparison of times, unless elimination by distance was expected to be faster and proved to be slower.
"""

_ON_LEAKS = 40.0
"""Additional memory of multigrid if every node has a leak, in bytes per node, measured on planes.

A leak is a conductance from a node to the high rail.
"""

_ON_LEVELS = 0.5e6
"""Memory of multigrid that does not depend on the number of rows, in bytes."""

_ON_ROWS = 500.0
"""Peak memory of a direct solution without its factors, in bytes per row."""


THREADED_ROWS = {2: 250_000, 3: 500_000}
"""Smallest number of rows of a grid, by number of dimensions, for which the multigrid method uses several threads.

Speed of two threads relative to one (``benchmarks/results.md``, unloaded computer): planes 1.2 to 1.3 at 1024^2, 1.4 at
512^2 with two right-hand sides; volumes 0.92 at 64^3.  Alternating runs on a loaded computer, minimum of all runs:
planes 0.85 at 256^2, 1.4 at 512^2, 1.3 at 1024^2; volumes 1.2 to 1.3 at 80^3, 1.1 to 1.3 at 100^3.  The limit of
volumes also applies in four dimensions.  No size with a gain was found off grids (0.92 to 1.04 at 100,000 and 300,000
nodes) and for the direct method (0.86 to 1.0).
"""


def threads_for(choice: MethodChoice, threads: ThreadTeam) -> ThreadTeam:
    """Return the given threads, or the single calling thread if several would not solve the matrix faster.

    `choice`: matrix and method; `threads`: available threads.
    """
    laplacian = choice.laplacian
    if choice.method != "multigrid" or laplacian.grid is None:
        return SINGLE_THREAD
    return threads if laplacian.size >= THREADED_ROWS[min(max(laplacian.dimensions, 2), 3)] else SINGLE_THREAD


def factor_laplacian(
    laplacian: Laplacian, method: str, *, accuracy: str = "direction", threads: ThreadTeam = SINGLE_THREAD
) -> Factor:
    """Choose a method, factor the matrix with it, and return the factors.

    Parameters
    ----------
    laplacian : Laplacian
        The matrix.
    method : {'auto', 'direct', 'multigrid'}
        Method; ``'auto'`` chooses the faster one.
    accuracy : {'direction', 'normwise'}, optional
        ``'direction'`` for a small relative error of every entry, ``'normwise'`` for a small backward error only.
    threads : ThreadTeam, optional
        Threads that are used if they make the solve faster.

    Returns
    -------
    Factor
        Factors or preconditioner of the matrix.

    Raises
    ------
    InputError
        For an unknown method.
    BudgetError
        If the factors do not fit in memory.
    """
    from resgrid.solvers.symbolic import order_by_fill

    check_method(method)
    choice = choose_method(laplacian, method, accuracy)
    require_memory(
        choice.memory,
        f"solving for {laplacian.size:,} unknowns by method = {choice.method!r}",
        "use fewer cells, or a machine with more memory",
    )
    if choice.method == "multigrid":
        return factor_multigrid(choice.laplacian, threads=threads_for(choice, threads))
    return factor_direct(choice.laplacian, choice.order or order_by_fill(choice.laplacian))


def check_method(method: str) -> None:
    """Raise InputError unless `method` is "auto", "direct" or "multigrid"."""
    if method != "auto" and method not in METHODS:
        raise InputError(f"method = {method!r} is unknown; it may be one of auto, {', '.join(METHODS)}")


def choose_method(laplacian: Laplacian, method: str = "auto", accuracy: str = "direction") -> MethodChoice:
    """Return the method with the lowest estimated cost, or the given one, with statistics and ordering.

    `laplacian`: the matrix; `method`: "auto", "direct" or "multigrid"; `accuracy`: "direction" for a small relative
    error of every entry, or "normwise" for a small backward error only.

    For "auto", the direct method is chosen below 2000 rows, on narrow corridors, and if conductances vary so strongly
    from node to node that no coarse grid represents them. Between two rails it is also chosen if the potential falls
    too far: multigrid refines about fifteen orders of magnitude at a time. The field `order` of the result is None if
    an order by distance would give the factors too many entries; the caller then orders by fill.
    """
    from resgrid.solvers.symbolic import order_by_distance

    if accuracy == "direction" or laplacian.grid is None or not laplacian.grid.simple:
        laplacian = laplacian.with_rows()
    statistics = conductance_statistics(laplacian)
    iterative = MethodChoice(laplacian, accuracy, statistics, "multigrid")
    if method == "multigrid":
        return iterative
    rough = statistics.weak > (_ROUGH_VOLUME if statistics.entries > VOLUME * laplacian.size else _ROUGH)
    if method == "auto" and laplacian.size >= _SMALL and statistics.entries and not rough:
        faster = _faster_for_directions if accuracy == "direction" else _faster_for_voltages
        choice = faster(iterative, _corridors_of(laplacian, statistics))
        if choice is not None:
            return choice
    laplacian = laplacian.with_rows()
    return MethodChoice(laplacian, accuracy, statistics, "direct", order_by_distance(laplacian))


class Corridors(NamedTuple):
    """Quantities that determine the costs of a matrix.

    A corridor is a strip of nodes between obstacles or borders of the grid. `width`: mean width of corridors, in cells,
    estimated from the number of neighbours that nodes lack in comparison with an open grid; infinite if they lack none;
    `along`: estimated seconds of a direct solution if rows are eliminated in the order of their distance from the
    ground (the known voltages), farthest first; `contrast`: factor on the time of multigrid for planes whose
    conductances span many orders of magnitude, 1 for other matrices.
    """

    width: float
    along: float
    contrast: float


def _corridors_of(laplacian: Laplacian, statistics: ConductanceStatistics) -> Corridors:
    """Return the width of corridors, the seconds of elimination along them, and the effect of unequal conductances.

    These quantities are estimated from the `statistics` of the conductances of the matrix and the dimensions of its
    grid alone.
    """
    n, dimensions = laplacian.size, laplacian.dimensions
    volume, missing = dimensions > 2, 2.0 * dimensions - statistics.entries / n
    width = 2.0 * (dimensions - 1) / missing if missing > 0.0 else np.inf
    along = (SECONDS.corridor[volume] + SECONDS.across[volume] * width**2) * n
    plane = laplacian.grid is not None and dimensions == 2
    contrast = 10.0 ** max(_CONTRAST * (statistics.decades - _EVEN), 0.0) if plane else 1.0
    return Corridors(width, along, contrast)


def _faster_for_directions(iterative: MethodChoice, corridors: Corridors) -> MethodChoice | None:
    """Return the faster method for the accuracy "direction"; None if the potential falls too far for multigrid.

    Too far is more than 250 orders of magnitude. After None the caller uses the direct method. `iterative`: the choice
    of multigrid; `corridors`: quantities that determine the costs. The fall of the potential is estimated unless
    elimination by distance from the ground (the known voltages), farthest rows first, is faster even for a fall by 30
    orders of magnitude. Too far a fall is ignored if this elimination was expected to be faster and proved to be
    slower.
    """
    from resgrid.solvers.decay_estimate import estimate_decades

    laplacian, (width, along, contrast) = iterative.laplacian, corridors
    seconds = contrast * multigrid_seconds(laplacian, width, _LEAST_DECADES)
    narrow = along < seconds
    choice = _by_distance(iterative, seconds) if narrow else None
    if choice is not None:
        return choice
    fall = estimate_decades(laplacian, iterative.statistics)
    if fall > _MOST_DECADES and not narrow:
        return None
    seconds = contrast * multigrid_seconds(laplacian, width, fall)
    if not narrow and along < seconds:
        choice = _by_distance(iterative, seconds)
    return choice or _by_fill(iterative, seconds) or iterative


def _faster_for_voltages(iterative: MethodChoice, corridors: Corridors) -> MethodChoice:
    """Return the faster method for normwise accuracy.

    `iterative`: the choice of multigrid; `corridors`: quantities that determine the costs. The direct method can be
    faster in two cases: elimination by distance from the ground along corridors narrower than 2.5 cells (chains and
    trees), and elimination by minimum fill on planes whose conductances span many orders of magnitude.
    """
    seconds = corridors.contrast * multigrid_seconds(iterative.laplacian, corridors.width, None)
    if corridors.width < SPARSE_WIDTH or corridors.contrast > 1.0:
        iterative = iterative._replace(laplacian=iterative.laplacian.with_rows())
    choice = _by_distance(iterative, seconds) if corridors.width < SPARSE_WIDTH else None
    if choice is None and corridors.contrast > 1.0:
        choice = _by_fill(iterative, seconds)
    return choice or iterative


def _by_distance(iterative: MethodChoice, seconds: float) -> MethodChoice | None:
    """Return the direct method with elimination by distance from the ground; None if this method is not faster.

    Rows farthest from the ground (the nodes of known voltage) are eliminated first. `iterative`: the choice of
    multigrid for the matrix; `seconds`: estimated time of multigrid.
    """
    from resgrid.solvers.symbolic import order_by_distance

    order = order_by_distance(iterative.laplacian)
    faster = order is not None and direct_seconds(order) < seconds
    return iterative._replace(method="direct", order=order) if faster else None


def _by_fill(iterative: MethodChoice, seconds: float) -> MethodChoice | None:
    """Return the direct method with elimination by minimum fill; None if ordering and solution together are not faster.

    `iterative`: the choice of multigrid for the matrix; `seconds`: estimated time of multigrid.
    """
    from resgrid.solvers.symbolic import order_by_fill

    laplacian, n = iterative.laplacian, iterative.laplacian.size
    left = seconds - (SECONDS.order + SECONDS.row) * n
    order = order_by_fill(laplacian, left / SECONDS.entry) if left > 0.0 else None
    faster = order is not None and direct_seconds(order) + SECONDS.order * n < seconds
    return iterative._replace(method="direct", order=order) if faster else None


def direct_memory(order: Symbolic) -> float:
    """Return the estimated peak memory of a direct solution in bytes, in addition to the netlist.

    `order`: elimination order and structure of the factors.
    """
    return 8.0 * (order.entries + len(order.nodes.rows)) + _ON_ROWS * len(order.order)


def direct_seconds(order: Symbolic) -> float:
    """Return the estimated time of a direct solution in seconds, without the time for computing the ordering.

    `order`: elimination order and structure of the factors.
    """
    rows = len(order.order)
    on_rows = (SECONDS.row if rows > EXACT_ROWS else SECONDS.exact_row) * rows
    return on_rows + SECONDS.entry * order.entries + SECONDS.product * order.products


def multigrid_seconds(laplacian: Laplacian, width: float, fall: float | None) -> float:
    """Return the estimated time of a multigrid solution, in seconds.

    `laplacian`: the matrix; `width`: width of corridors in cells; `fall`: orders of magnitude by which the potential
    falls, None for a solution of normwise accuracy.
    """
    tortuous = width < OPEN_WIDTH
    if fall is None:
        a_row = SECONDS.normwise
    elif laplacian.rails is None and width < SPARSE_WIDTH:
        a_row = SECONDS.driven_sparse
    elif laplacian.rails is None:
        a_row = (
            SECONDS.driven_netlist
            if laplacian.grid is None
            else SECONDS.driven_tortuous
            if tortuous
            else SECONDS.driven
        )
    elif laplacian.grid is None:
        a_row = SECONDS.netlist + SECONDS.netlist_decade * fall
    else:
        a_row = (SECONDS.tortuous if tortuous else SECONDS.open) + SECONDS.decade[laplacian.dimensions > 2] * fall
    return SECONDS.levels + a_row * laplacian.size
