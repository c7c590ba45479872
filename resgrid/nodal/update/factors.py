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
from resgrid.nodal.update.change import Change, change_cells, without_zeros

_LARGE = 0.03
"""Share of the rows from which levels are built anew."""


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
    system, change = change_cells(factors.system, before, cells, to)
    if len(change.pinned) == (len(before.pinned) if before is not None else 0):
        return replace(factors, change=change)
    if isinstance(factors, ReducedFactor):
        name = "auto" if factors.name == ELIMINATION else factors.name
        return _anew(system, change, "eliminated nodes are eliminated again", partial(factor_system, method=name))
    if isinstance(factors, DirectFactor):
        return _anew(system, change, "factors of the direct method are made again", METHODS["direct"])
    reason = "the levels are made again"
    return _anew(system, change, reason, METHODS["multigrid"])


def _anew(system: NodalSystem, change: Change, reason: str, make: Callable[[NodalSystem], Factor]) -> Factor:
    factors = make(without_zeros(system))
    assert isinstance(factors, DirectFactor | MultigridFactor | ReducedFactor)
    return replace(factors, change=replace(change, reason=change.reason or reason))
