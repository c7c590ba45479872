"""Update a factor after some cells have changed: what it has is patched, or, where that does not pay, made anew."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from numpy.typing import ArrayLike

from resgrid.errors import InputError
from resgrid.nodal.direct import DirectFactor
from resgrid.nodal.factor import Factor
from resgrid.nodal.methods import METHODS, factor_system
from resgrid.nodal.multigrid.solver import MultigridFactor
from resgrid.nodal.reduction.reduced_factor import ELIMINATION, ReducedFactor
from resgrid.nodal.system import NodalSystem
from resgrid.nodal.update.change import Change, change_cells
from resgrid.nodal.update.levels import patch_levels


def update_factor(factors: Factor, cells: ArrayLike, to: int) -> Factor:
    """Factor a circuit again after free cells have become obstacles or goals.

    Parameters
    ----------
    factors : Factor
    cells : array_like of int, shape (k, ndim)
        Cell indices.
    to : Cell
        ``Cell.OBSTACLE`` or ``Cell.GOAL``.

    Returns
    -------
    Factor
        Of the same rows; its ``change`` says what was done.

    Raises
    ------
    InputError
        If a cell is not free, or the netlist does not come from a space with merged rails.
    CircuitError
        If nothing is driven any more.
    """
    if not isinstance(factors, DirectFactor | MultigridFactor | ReducedFactor):
        raise InputError(f"a factor of type {type(factors).__name__} cannot be updated")
    before = factors.change
    hierarchy = factors.hierarchy if isinstance(factors, MultigridFactor) and factors.hierarchy.grid else None
    system, change = change_cells(factors.system, hierarchy, before, cells, to)
    if system is factors.system:
        return replace(factors, change=change)
    if isinstance(factors, ReducedFactor):
        name = "auto" if factors.name == ELIMINATION else factors.name
        return _anew(system, change, "eliminated nodes are eliminated again", partial(factor_system, method=name))
    if isinstance(factors, DirectFactor):
        return _anew(system, change, "factors of the direct method are made again", METHODS["direct"])
    reason = change.reason
    if hierarchy is None:
        reason = "the levels are graphs, which are made again"
    if not reason and hierarchy is not None:
        patched = patch_levels(hierarchy, system, change, change.cells[0 if before is None else len(before.cells) :])
        if patched is not None:
            return replace(factors, system=system, patched=patched[0], change=change, windows=patched[1])
        reason = "the changed cells are all over the grid"
    return _anew(system, change, reason, METHODS["multigrid"])


def _anew(system: NodalSystem, change: Change, reason: str, make: Callable[[NodalSystem], Factor]) -> Factor:
    factors = make(replace(system, derived=system.coupling, separated=None))
    assert isinstance(factors, DirectFactor | MultigridFactor | ReducedFactor)
    return replace(factors, change=replace(change, reason=change.reason or reason))
