"""What a method costs, in seconds and bytes, estimated before it is taken.

Seconds are those of one core of the computer on which ``benchmarks/choice.py`` measured all methods on planes, volumes,
mazes and netlists; it tells what the choice loses against the best of them. Only their ratios matter.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from resgrid.solvers.connections import count_connections
from resgrid.solvers.decay import h_transform_pays
from resgrid.solvers.factors.direct import EXACT_ROWS
from resgrid.solvers.laplacian import Laplacian
from resgrid.solvers.supernodal import ON_ROWS, Symbolic, order_by_distance


class Seconds(NamedTuple):
    """The table: seconds a row, unless said.

    `corridor, across`: a direct solution along corridors, and for every square cell of their width (plane, volume);
    `row, exact_row`: of factors and substitution but for their entries, and where the answer is the nearest double;
    `entry, product`: an entry of the factors, a product; `order`: an order of minimum degree; `levels`: levels,
    however few the rows, in all; `open, mazy`: directions by multigrid on a grid between rails; `decade, far_decade`:
    for every decade that the potential falls, where an h-transform reaches and where not; `fed, fed_mazy, fed_netlist`:
    directions where one rail is driven; `netlist, netlist_decade`: between rails off grids.
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
    decade: float = 0.012e-6
    far_decade: float = 0.025e-6
    fed: float = 0.5e-6
    fed_mazy: float = 0.9e-6
    fed_netlist: float = 1.6e-6
    netlist: float = 4e-6
    netlist_decade: float = 0.04e-6


SECONDS = Seconds()

ROOM = 20.0
"""Cells across a corridor from which cycles converge as in the open."""


def corridor_width(laplacian: Laplacian) -> float:
    """Cells across the corridors of a maze whose nodes have as many neighbours on average; infinite in the open."""
    dimensions = laplacian.dimensions
    missing = 2.0 * dimensions - count_connections(laplacian).entries / laplacian.size
    return 2.0 * (dimensions - 1) / missing if missing > 0.0 else np.inf


def corridor_seconds(laplacian: Laplacian, width: float) -> float:
    """Time of a direct solution along corridors of one width, before an order is found."""
    volume = laplacian.dimensions > 2
    return (SECONDS.corridor[volume] + SECONDS.across[volume] * width**2) * laplacian.size


def direct_seconds(order: Symbolic) -> float:
    """Time of a direct solution in an order that has been found."""
    return row_seconds(len(order.reduced.number)) + SECONDS.entry * order.entries + SECONDS.product * order.products


def row_seconds(rows: int) -> float:
    """The part of it that goes by the rows."""
    return (SECONDS.row if rows > EXACT_ROWS else SECONDS.exact_row) * rows


def most_entries(laplacian: Laplacian, seconds: float) -> float:
    """Entries of factors by minimum degree that can be had in some time; none if the order alone takes longer."""
    left = seconds - SECONDS.order * laplacian.size - row_seconds(laplacian.size)
    return max(left, 0.0) / SECONDS.entry


def multigrid_seconds(laplacian: Laplacian, decades: float, *, scaled: bool = True) -> float:
    """Time of directions by multigrid; ``scaled``: whether an h-transform reaches all the decades."""
    mazy = corridor_width(laplacian) < ROOM
    if laplacian.rails is None:
        a_row = SECONDS.fed_netlist if laplacian.grid is None else SECONDS.fed_mazy if mazy else SECONDS.fed
    elif laplacian.grid is None:
        a_row = SECONDS.netlist + SECONDS.netlist_decade * decades
    else:
        a_decade = SECONDS.decade if scaled else SECONDS.far_decade
        a_row = (SECONDS.mazy if mazy else SECONDS.open) + a_decade * decades
    return SECONDS.levels + a_row * laplacian.size


def estimate_memory(laplacian: Laplacian, method: str, accuracy: str = "direction") -> float:
    """Estimate the peak memory of a method above the netlist, in bytes.

    Entries of narrow circuits' factors are counted (`resgrid.solvers.supernodal`).  Those of multigrid are a tenth
    above what was measured on grids, which do without compressed rows, and on other netlists; directions take rows and
    scaled numbers besides, and with an h-transform, as in most planes, a second set of them.
    """
    if method == "multigrid":
        on_nodes, on_entries = (100.0, 12.0) if laplacian.grid is not None else (230.0, 22.0)
        if accuracy == "direction":
            on_nodes, on_entries = on_nodes + (120.0 if h_transform_pays(laplacian) else 60.0), on_entries + 18.0
        return on_nodes * laplacian.size + on_entries * count_connections(laplacian).entries
    narrow = order_by_distance(laplacian)
    return narrow.memory if narrow is not None else wide_memory(laplacian)


def wide_memory(laplacian: Laplacian) -> float:
    """Memory of factors by minimum degree: about ``n log n`` entries on planes, ``n**(4/3)`` in three dimensions.

    ``n**(3/2)`` in four (George & Liu 1981); the constants were measured on open grids, which fill most.
    """
    n = laplacian.size
    fill = {2: 2.6 * n * np.log2(n + 2), 3: 10.0 * n ** (4 / 3), 4: 4.5 * n ** (3 / 2)}.get(
        laplacian.dimensions, 3.0 * n
    )
    return float(9.0 * fill + ON_ROWS * n)
