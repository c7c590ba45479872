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
    where the conductances differ by many decades or the graph is mostly corridors, which fill little and smooth badly.
    """
    if not system.size or not system.coupling.nnz:
        return "direct"
    neighbours = system.coupling.nnz / system.size
    conductance = system.coupling.data
    if conductance.max() > _MOST_CONTRAST * conductance.min():
        return "direct"
    if neighbours > _VOLUME and system.size > _LARGE_VOLUME:
        return "multigrid"
    return "multigrid" if neighbours > _PLANE and system.size > _LARGE_PLANE else "direct"


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
