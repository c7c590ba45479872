"""Which methods there are, which one suits a system, and what it would take."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from resgrid.budget import require_memory
from resgrid.errors import InputError
from resgrid.nodal.direct import factor_direct
from resgrid.nodal.factor import Factor
from resgrid.nodal.multigrid.solver import factor_multigrid
from resgrid.nodal.system import NodalSystem

METHODS: dict[str, Callable[[NodalSystem], Factor]] = {"direct": factor_direct, "multigrid": factor_multigrid}

_VOLUME, _PLANE = 4.2, 3.5
"""Neighbours a node from which a graph fills like a volume, and like a plane; less is mostly corridors."""

_LARGE_VOLUME = 20_000
_LARGE_PLANE = 1_000_000
_MOST_CONTRAST = 1e3
_MOST_DECADES = 150.0


def factor_system(system: NodalSystem, method: str) -> Factor:
    """Make a system ready to be solved, unless it would not fit in memory.

    Parameters
    ----------
    system : NodalSystem
    method : {"auto", "direct", "multigrid"}

    Returns
    -------
    Factor

    Raises
    ------
    InputError
        If the method is unknown.
    BudgetError
        If the estimate exceeds what is free.
    """
    if method != "auto" and method not in METHODS:
        raise InputError(f"method = {method!r} is unknown; it may be one of auto, {', '.join(METHODS)}")
    name = choose_method(system) if method == "auto" else method
    require_memory(
        estimate_memory(system, name),
        f"solving for {system.size:,} unknowns by method = {name!r}",
        "use a coarser grid, or a machine with more memory",
    )
    return METHODS[name](system)


def choose_method(system: NodalSystem) -> str:
    """Choose a method beforehand.

    Multigrid where direct factors fill too much: volumes beyond twenty thousand nodes, planes beyond a million.  Direct
    where the conductances differ by many decades or the graph is mostly corridors, which fill little, smooth badly, and
    between two rails lose more decades than refinement would want to win back nine by nine.
    """
    if not system.size or not system.coupling.nnz:
        return "direct"
    neighbours = system.coupling.nnz / system.size
    conductance = system.coupling.data
    if conductance.max() > _MOST_CONTRAST * conductance.min():
        return "direct"
    volume = neighbours > _VOLUME and system.size > _LARGE_VOLUME
    plane = neighbours > _PLANE and system.size > _LARGE_PLANE
    if not (volume or plane) or _decades(system, volume=volume) > _MOST_DECADES:
        return "direct"
    return "multigrid"


def _decades(system: NodalSystem, *, volume: bool) -> float:
    """Rough number of decades that a potential between two rails falls over the graph; 0 for other circuits.

    Along a corridor ``w`` cells wide it falls by ``exp(-pi sqrt(d) / w)`` a cell, in ``d = 1`` or 2 cross dimensions;
    length and width are those of a breadth-first search from the low rail.
    """
    if system.rails is None:
        return 0.0
    from resgrid.nodal.kernels import breadth_first

    coupling = system.coupling
    levels, reached = breadth_first(coupling.indptr, coupling.indices, system.rails.to_low > 0)
    section = max(reached / max(levels, 1), 1.0)
    width, dimensions = (section**0.5, 2) if volume else (section, 1)
    return float(levels * np.pi * np.sqrt(dimensions) / width / np.log(10.0))


def estimate_memory(system: NodalSystem, method: str = "direct") -> float:
    """Estimate the peak memory of a method, in bytes.

    Direct fill grows about as ``n log n`` on planar grids, ``n**(4/3)`` in three and ``n**(3/2)`` in four dimensions
    (George & Liu 1981); the constants were measured under minimum degree on open grids, which fill most.
    """
    n = system.size
    if method == "multigrid":
        return 400.0 * n + 40.0 * system.coupling.nnz
    layout = system.netlist.layout
    dimensions = sum(size > 2 for size in layout.space.shape) if layout is not None else 2
    fill = {
        0: 3.0 * n,
        1: 3.0 * n,
        2: 2.6 * n * np.log2(n + 2),
        3: 10.0 * n ** (4 / 3),
        4: 4.5 * n ** (3 / 2),
    }[dimensions]
    return float(50 * fill + 600 * n)
