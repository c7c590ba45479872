"""Which methods there are, which one suits a laplacian, and what each costs, estimated before it is taken.

Seconds are those of one core of the computer on which ``benchmarks/choice.py`` measured all methods on planes, volumes,
mazes and netlists; it tells what the choice loses against the best of them. Only their ratios matter.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from resgrid._internal.memory import require_memory
from resgrid.errors import InputError
from resgrid.solvers.factors import EXACT_ROWS, Factor, factor_direct, factor_multigrid
from resgrid.solvers.laplacian import VOLUME, Connections, Laplacian, count_connections
from resgrid.solvers.threads import ALONE, ThreadTeam

if TYPE_CHECKING:
    from resgrid.solvers.symbolic import Symbolic

METHODS = ("direct", "multigrid")


class Seconds(NamedTuple):
    """The table: seconds a row, unless said.

    `corridor, across`: a direct solution along corridors, and for every square cell of their width (plane, volume);
    `row, exact_row`: of factors and substitution but for their entries, and where the answer is the nearest double;
    `entry, product`: an entry of the factors, a product; `order`: an order of minimum fill; `levels`: levels,
    however few the rows, in all; `open, mazy`: directions by multigrid on a grid between rails; `decade`: for every
    decade that the potential falls (plane, volume); `fed, fed_mazy, fed_sparse, fed_netlist`: directions where one rail
    is driven; `netlist, netlist_decade`: between rails off grids; `normwise`: voltages alone in narrow corridors.
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
    mazy: float = 0.7e-6
    decade: tuple[float, float] = (0.02e-6, 0.012e-6)
    fed: float = 0.5e-6
    fed_mazy: float = 0.9e-6
    fed_sparse: float = 4e-6
    fed_netlist: float = 1.6e-6
    netlist: float = 4e-6
    netlist_decade: float = 0.04e-6
    normwise: float = 0.45e-6


SECONDS = Seconds()

ROOM = 20.0
"""Cells across a corridor from which cycles converge as in the open."""

SPARSE = 2.5
"""Cells across corridors, chains and trees in which cycles take longest: rows have three neighbours, or fewer."""


class MethodChoice(NamedTuple):
    """A method for a laplacian, and what was found out on the way to it.

    `laplacian`: with its rows, where they had to be made; `accuracy`: of the answers it was chosen for; `found`: counts
    over it; `method`; `order`: of a direct method; None where the order by fill is to be taken.
    """

    laplacian: Laplacian
    accuracy: str
    found: Connections
    method: str
    order: Symbolic | None = None

    @property
    def memory(self) -> float:
        """Estimate of its peak memory above the netlist, in bytes.

        Entries of narrow circuits' factors are counted (`resgrid.solvers.symbolic`); in the open there are about ``n
        log n`` of them on planes, ``n**(4/3)`` in three dimensions, ``n**(3/2)`` in four (George & Liu 1981), with
        constants measured on open grids, which fill most.  Those of multigrid are a tenth above what was measured on
        grids, which do without compressed rows, and on other netlists; directions take rows and scaled numbers besides.
        """
        laplacian, order, n = self.laplacian, self.order, self.laplacian.size
        if self.method == "multigrid":
            on_nodes, on_entries = (100.0, 12.0) if laplacian.grid is not None else (230.0, 22.0)
            if self.accuracy == "direction":
                on_nodes, on_entries = on_nodes + 60.0, on_entries + 18.0
            return on_nodes * n + on_entries * self.found.entries + _ON_LEVELS
        if order is not None:
            return 8.0 * (order.entries + len(order.nodes.rows)) + _ON_ROWS * n
        fill = {2: 2.6 * n * np.log2(n + 2), 3: 10.0 * n ** (4 / 3), 4: 4.5 * n ** (3 / 2)}
        return float(9.0 * fill.get(laplacian.dimensions, 3.0 * n) + _ON_ROWS * n)


_SMALL = 2000
"""Rows up to which the direct method is always quicker."""

_ROUGH, _ROUGH_VOLUME = 0.25, 0.5
"""Share of weak conductances above which cycles are too many; in a volume direct factors cost so much more."""

_EVEN, _PATCHED = 3.0, 0.4
"""Decades by which conductances of a plane may differ; those of the time that each one more takes."""

_LEAST_DECADES, _MOST_DECADES = 30.0, 250.0
"""By how many decades any maze's potential falls, and from how many on refinement takes too long."""

_ON_LEVELS = 0.5e6
"""Bytes that multigrid takes, whatever the size."""

_ON_ROWS = 500.0
"""Peak memory of a direct solution besides its factors, in bytes a row."""


def factor_laplacian(
    laplacian: Laplacian, method: str, *, accuracy: str = "direction", team: ThreadTeam = ALONE
) -> Factor:
    """Make a system ready to be solved, on a team's threads, unless it would not fit in memory.

    An ``accuracy`` of ``"normwise"`` tells that no answer needs to be right entry by entry.
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
        return factor_multigrid(choice.laplacian, team=team)
    return factor_direct(choice.laplacian, choice.order or order_by_fill(choice.laplacian))


def check_method(method: str) -> None:
    """Refuse a method that is none."""
    if method != "auto" and method not in METHODS:
        raise InputError(f"method = {method!r} is unknown; it may be one of auto, {', '.join(METHODS)}")


def choose_method(laplacian: Laplacian, method: str = "auto", accuracy: str = "direction") -> MethodChoice:
    """Choose a method beforehand, where none is given: the one that would take less time.

    Direct where the laplacian is small, or narrow; where conductances differ so wildly from node to node that no coarse
    grid stands for them; and between two rails where the potential falls by more decades than refinement wins back in
    that time, some fifteen a pass.
    """
    from resgrid.solvers.symbolic import order_by_distance

    if accuracy == "direction" or laplacian.grid is None or not laplacian.grid.simple:
        laplacian = laplacian.with_rows()
    found = count_connections(laplacian)
    rough = found.weak > (_ROUGH_VOLUME if found.entries > VOLUME * laplacian.size else _ROUGH)
    if method == "multigrid":
        return MethodChoice(laplacian, accuracy, found, method)
    if method == "auto" and laplacian.size >= _SMALL and found.entries and not rough:
        choice = _in_less_time(laplacian, found, accuracy)
        if choice is not None:
            return choice
    laplacian = laplacian.with_rows()
    return MethodChoice(laplacian, accuracy, found, "direct", order_by_distance(laplacian))


def _in_less_time(laplacian: Laplacian, found: Connections, accuracy: str) -> MethodChoice | None:
    """The direct method in either order, if it takes less time than multigrid would; None where it must be taken.

    For voltages alone it may do so in the order by distance, along the narrowest corridors, chains and trees, and where
    planes are patched of conductances that differ by many decades.  The fall of the potential is not asked for where
    corridors are narrow enough for any.
    """
    from resgrid.solvers.decay_estimate import foresee_decades
    from resgrid.solvers.symbolic import order_by_distance, order_by_fill

    n, dimensions, fall, foreseen = laplacian.size, laplacian.dimensions, None, None
    volume, missing = dimensions > 2, 2.0 * dimensions - found.entries / n
    # Cells across corridors, by the neighbours that nodes lack.
    width = 2.0 * (dimensions - 1) / missing if missing > 0.0 else np.inf
    along = (SECONDS.corridor[volume] + SECONDS.across[volume] * width**2) * n
    plane = laplacian.grid is not None and dimensions == 2
    patched = 10.0 ** max(_PATCHED * (found.decades - _EVEN), 0.0) if plane else 1.0
    if width < SPARSE or patched > 1.0:
        laplacian = laplacian.with_rows()
    if accuracy == "direction":
        fall = _LEAST_DECADES
        if along >= patched * multigrid_seconds(laplacian, width, fall):
            fall = foreseen = foresee_decades(laplacian, found)
            if fall > _MOST_DECADES:
                return None
    seconds = patched * multigrid_seconds(laplacian, width, fall)
    if width < SPARSE if fall is None else along < seconds:
        narrow = order_by_distance(laplacian)
        if narrow is not None and direct_seconds(narrow) < seconds:
            return MethodChoice(laplacian, accuracy, found, "direct", narrow)
        fall = None if fall is None else foreseen or foresee_decades(laplacian, found)
        seconds = patched * multigrid_seconds(laplacian, width, fall)
    left = seconds - (SECONDS.order + SECONDS.row) * n
    asked = left > 0.0 and (fall is not None or patched > 1.0)
    wide = order_by_fill(laplacian, left / SECONDS.entry) if asked else None
    if wide is not None and direct_seconds(wide) + SECONDS.order * n < seconds:
        return MethodChoice(laplacian, accuracy, found, "direct", wide)
    return MethodChoice(laplacian, accuracy, found, "multigrid")


def direct_seconds(order: Symbolic) -> float:
    """Time of a direct solution in an order that has been found."""
    rows = len(order.order)
    on_rows = (SECONDS.row if rows > EXACT_ROWS else SECONDS.exact_row) * rows
    return on_rows + SECONDS.entry * order.entries + SECONDS.product * order.products


def multigrid_seconds(laplacian: Laplacian, width: float, fall: float | None) -> float:
    """Time of voltages by multigrid, or of directions, by the width of corridors and the fall of the potential."""
    mazy = width < ROOM
    if fall is None:
        a_row = SECONDS.normwise
    elif laplacian.rails is None and width < SPARSE:
        a_row = SECONDS.fed_sparse
    elif laplacian.rails is None:
        a_row = SECONDS.fed_netlist if laplacian.grid is None else SECONDS.fed_mazy if mazy else SECONDS.fed
    elif laplacian.grid is None:
        a_row = SECONDS.netlist + SECONDS.netlist_decade * fall
    else:
        a_row = (SECONDS.mazy if mazy else SECONDS.open) + SECONDS.decade[laplacian.dimensions > 2] * fall
    return SECONDS.levels + a_row * laplacian.size
