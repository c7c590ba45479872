"""Some cells become obstacles or goals: the nodal equations after that, rows numbered as before.

A row whose cell has changed is cut off and pinned at its rail.  What led to its neighbours becomes their contact with
that rail, by the compiler's rules: the free cell's conductivity counts alone, an obstacle stands behind its wall, and
open obstacles leave nothing.  A uniform drive is shared out anew among the rows that are left.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.conductances import in_series, of_obstacle
from resgrid.errors import CircuitError, InputError
from resgrid.netlist import CellMap
from resgrid.nodal.multigrid.hierarchy import Hierarchy
from resgrid.nodal.rails import Rails, Ties
from resgrid.nodal.system import NodalSystem
from resgrid.nodal.update.neighbourhood import Neighbourhood, neighbourhood
from resgrid.space import Cell, ConfigurationSpace


@dataclass(frozen=True, eq=False)
class Change:
    """What has changed since the netlist was compiled.

    `cells` (changed,): flat indices (C order) of all cells that changed; `codes` (changed,): what they have become
    (`Cell`); `pinned`: rows that no longer take part: those of changed cells, and of parts that nothing holds any
    more; `pairs` (p, 2): rows that the last update has separated: one that is cut off, and its neighbour; `gain`: by
    how much the last update has raised the uniform drive of the rows that are left; `reason`: why the factor was made
    anew; empty where what it had could be kept.
    """

    cells: NDArray[np.int64]
    codes: NDArray[np.uint8]
    pinned: NDArray[np.int64]
    pairs: NDArray[np.int64]
    gain: float = 1.0
    reason: str = ""

    def space(self, before: ConfigurationSpace) -> ConfigurationSpace:
        """The space after all changes."""
        cell = before.cell.copy()
        cell.flat[self.cells] = self.codes
        return before.with_cells(cell)

    def with_cells(self, cells: NDArray[np.int64], code: Cell) -> Change:
        """The same, and some more cells."""
        codes = np.full(len(cells), code, dtype=np.uint8)
        return replace(
            self, cells=np.concatenate([self.cells, cells]), codes=np.concatenate([self.codes, codes]), reason=""
        )


NOTHING = Change(
    np.empty(0, dtype=np.int64), np.empty(0, dtype=np.uint8), np.empty(0, dtype=np.int64), np.empty((0, 2), np.int64)
)


def change_cells(
    system: NodalSystem, hierarchy: Hierarchy | None, before: Change | None, cells: ArrayLike, to: int
) -> tuple[NodalSystem, Change]:
    """Turn free cells into obstacles or goals.  Shapes: `cells` (k, ndim)."""
    cell_map = _checked_cells(system)
    before = NOTHING if before is None else before
    code = _checked_code(to)
    flat = _fresh_cells(cell_map, before, cells, code)
    row = _rows_of(system, cell_map, flat, code)
    flat_rows, rows = flat[row >= 0], row[row >= 0]
    if not len(rows):
        return system, before.with_cells(flat, code)
    around = neighbourhood(system, hierarchy)
    contacts = _contacts(system, cell_map, around, flat_rows, rows, code)
    changed = _cut_off(system, cell_map, around, rows, contacts, code)
    lost, reason = _lost(system, changed, around, rows, contacts, before)
    pinned = np.concatenate([before.pinned, rows, lost])
    changed, gain = _driven_again(_cut_loose(changed, lost), pinned)
    pairs = np.stack([contacts.cut, contacts.neighbour], axis=1)
    return changed, replace(before.with_cells(flat, code), pinned=pinned, pairs=pairs, gain=gain, reason=reason)


def _checked_cells(system: NodalSystem) -> CellMap:
    cell_map = system.netlist.cell_map
    if cell_map is None or cell_map.wiring.rails != "merged":
        raise InputError(
            "cells can only be updated in a circuit compiled from a space with rails = 'merged'; change the space or "
            "the netlist, and factor it anew"
        )
    return cell_map


def _checked_code(to: int) -> Cell:
    if to not in (Cell.OBSTACLE, Cell.GOAL):
        raise InputError(
            f"to = {to!r}, but a cell may become Cell.OBSTACLE or Cell.GOAL only; to free cells, factor the changed "
            "space anew"
        )
    return Cell(to)


def _fresh_cells(cell_map: CellMap, before: Change, cells: ArrayLike, code: Cell) -> NDArray[np.int64]:
    """Flat indices of the cells that are to change and have not yet."""
    shape = cell_map.space.shape
    try:
        index = np.asarray(cells)
    except ValueError:
        raise InputError("cells must be rows of cell indices of one length") from None
    index = index.reshape(0, len(shape)) if index.size == 0 else np.atleast_2d(index)
    if index.ndim != 2 or index.shape[1] != len(shape) or (index.size and index.dtype.kind not in "iu"):
        raise InputError(f"cells must be whole numbers, {len(shape)} a cell, got {index.dtype} of shape {index.shape}")
    outside = np.flatnonzero(np.any((index < 0) | (index >= shape), axis=1))
    if outside.size:
        raise InputError(f"the cell {tuple(index[outside[0]].tolist())} is not in the grid of {shape} cells")
    flat = np.unique(np.ravel_multi_index(tuple(index.astype(np.int64).T), shape))
    now = cell_map.space.cell.ravel()[flat].copy()
    there, here = np.nonzero(before.cells[:, None] == flat[None, :]) if len(before.cells) else (flat[:0], flat[:0])
    now[here] = before.codes[there]
    taken = np.flatnonzero((now != Cell.FREE) & (now != code))
    if taken.size:
        cell = tuple(int(i) for i in np.unravel_index(flat[taken[0]], shape))
        raise InputError(
            f"the cell {cell} is {Cell(now[taken[0]]).name.lower()}, and only free cells can be updated; factor the "
            "changed space anew"
        )
    return np.asarray(flat[now == Cell.FREE], dtype=np.int64)


def _rows_of(system: NodalSystem, cell_map: CellMap, flat: NDArray[np.int64], code: Cell) -> NDArray[np.int64]:
    """Rows of cells; -1 where nothing flows and a change makes no difference."""
    node = cell_map.node.ravel()[flat]
    row = np.where(node >= 0, system.unknown[node], -1)
    if cell_map.wiring.start is not None and np.any(
        flat == np.ravel_multi_index(cell_map.wiring.start, cell_map.space.shape)
    ):
        raise InputError(f"the cell {cell_map.wiring.start} is the driven start; compile the space with another start")
    resting = np.flatnonzero(row < 0)
    changes = resting[_would_feed(system, cell_map, node[resting], code)] if resting.size else resting
    if changes.size:
        cell = tuple(int(i) for i in np.unravel_index(flat[changes[0]], cell_map.space.shape))
        raise InputError(f"the cell {cell} is in a part that carries no current yet; factor the changed space anew")
    return np.asarray(row, dtype=np.int64)


def _would_feed(system: NodalSystem, cell_map: CellMap, node: NDArray[np.int32], code: Cell) -> NDArray[np.bool_]:
    """Which nodes of parts where nothing flows a new rail would feed: those that are not at its voltage."""
    if code == Cell.OBSTACLE and cell_map.wiring.boundary == "neumann":
        return np.zeros(len(node), dtype=np.bool_)
    volts = cell_map.wiring.goal_voltage + (cell_map.wiring.supply if code == Cell.OBSTACLE else 0.0)
    return np.asarray((node < 0) | (system.known[node] != volts))


@dataclass(frozen=True, eq=False)
class _Contacts:
    """Resistors of rows that are cut off: the row, its neighbour, and what becomes of the conductance."""

    cut: NDArray[np.int64]
    neighbour: NDArray[np.int64]
    conductance: NDArray[np.float64]


def _contacts(
    system: NodalSystem,
    cell_map: CellMap,
    around: Neighbourhood,
    flat: NDArray[np.int64],
    rows: NDArray[np.int64],
    code: Cell,
) -> _Contacts:
    space = cell_map.space
    here, there = _neighbours(space, flat)
    node = cell_map.node.ravel()[there]
    row = rows[here]
    other = np.where(node >= 0, system.unknown[node], -1)
    pairs, first, times = np.unique(
        np.stack([row, other], axis=1)[other >= 0], axis=0, return_index=True, return_counts=True
    )
    joined = around.between(pairs)
    inner, outer = flat[here][other >= 0][first], there[other >= 0][first]
    present = joined > 0
    if around.joins(rows) != np.count_nonzero(present):
        raise InputError("a cell that is to change has resistors to nodes that are no cells; factor the circuit anew")
    pairs, times = pairs[present], times[present]
    single = joined[present] / times
    if space.conductivity is not None:
        c = space.conductivity.ravel()
        ours, theirs = c[inner[present]], c[outer[present]]
        single = single * (in_series(ours, theirs, False, True) / in_series(ours, theirs, True, True))
    if code == Cell.OBSTACLE:
        single = of_obstacle(single, cell_map.wiring.boundary, cell_map.wiring.wall_resistance)
    return _Contacts(pairs[:, 0], pairs[:, 1], single * times)


def _neighbours(space: ConfigurationSpace, flat: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Number of the cell and flat index of the neighbour, across every face that has one."""
    index = np.stack(np.unravel_index(flat, space.shape))
    here, there = [], []
    for axis, size in enumerate(space.shape):
        for step in (-1, 1):
            moved = index.copy()
            moved[axis] += step
            if space.axes[axis].periodic and size > 1:
                moved[axis] %= size
            inside = np.flatnonzero((moved[axis] >= 0) & (moved[axis] < size))
            here.append(inside)
            there.append(np.ravel_multi_index(tuple(moved[:, inside]), space.shape))
    return np.concatenate(here), np.concatenate(there)


def _cut_off(
    system: NodalSystem,
    cell_map: CellMap,
    around: Neighbourhood,
    rows: NDArray[np.int64],
    contacts: _Contacts,
    code: Cell,
) -> NodalSystem:
    """Move resistors to the rail, and pin the rows there."""
    rails = system.rails
    low, high = (
        (cell_map.wiring.goal_voltage, cell_map.wiring.goal_voltage + cell_map.wiring.supply)
        if rails is None
        else (rails.low, rails.high)
    )
    at_high = code == Cell.OBSTACLE and cell_map.wiring.boundary != "neumann"
    volts = (high if at_high else low) - system.reference
    stays = ~np.isin(contacts.neighbour, rows)
    tie = _Tie(contacts.neighbour[stays], contacts.conductance[stays], rows, system.degree[rows])
    apart = np.stack([contacts.cut, contacts.neighbour], axis=1)
    separated = apart if system.separated is None else np.concatenate([system.separated, apart])
    fed = volts != 0.0 or bool(system.feed[rows].any())
    excess = tie.of(system.excess, 1.0)
    return replace(
        system,
        separated=separated,
        summed=around.sums(excess, tie.to, apart),
        excess=excess,
        feed=tie.of(system.feed, volts) if fed else system.feed,
        rails=rails and replace(rails, ties=partial(_tied, rails, tie, at_high)),
    )


@dataclass(frozen=True, eq=False)
class _Tie:
    """Rows tied to a rail by so much more, and rows pinned there by as much as held them before."""

    to: NDArray[np.int64]
    amount: NDArray[np.float64]
    pinned: NDArray[np.int64]
    pin: NDArray[np.float64]

    def of(self, before: NDArray[np.float64], factor: float) -> NDArray[np.float64]:
        """What ties the rows, or what they are fed."""
        after = before.copy()
        np.add.at(after, self.to, factor * self.amount)
        after[self.pinned] = factor * self.pin
        return after


def _tied(rails: Rails, tie: _Tie, at_high: bool) -> Ties:
    return tie.of(rails.to_high, float(at_high)), tie.of(rails.to_low, float(not at_high))


def _lost(
    system: NodalSystem,
    changed: NodalSystem,
    around: Neighbourhood,
    rows: NDArray[np.int64],
    contacts: _Contacts,
    before: Change,
) -> tuple[NDArray[np.int64], str]:
    """Rows that nothing holds any more, and a reason to build levels anew where the circuit has fallen apart."""
    seeds = np.setdiff1d(contacts.neighbour, rows)
    if len(seeds) and around.stay_together(system, changed, rows, seeds):
        return rows[:0], ""
    return _search_all(changed, seeds, np.concatenate([before.pinned, rows]))


def _search_all(
    changed: NodalSystem, seeds: NDArray[np.int64], pinned: NDArray[np.int64]
) -> tuple[NDArray[np.int64], str]:
    """The same for the whole circuit."""
    from scipy.sparse.csgraph import connected_components

    rails = changed.rails
    ties = (changed.excess, changed.excess) if rails is None else (rails.to_low, rails.to_high)
    taking = np.ones(changed.size, dtype=np.bool_)
    taking[pinned] = False
    count, part = connected_components(changed.coupling, directed=False)
    low, high = (np.bincount(part[taking], tie[taking], count) > 0 for tie in ties)
    fed = np.bincount(part[taking], changed.injected[taking] != 0, count) > 0
    driven = low & high & (fed if rails is None else True)
    if not driven.any():
        raise CircuitError(
            "nothing is driven any more: the changed cells leave no way between the rails, or from the drive to a goal"
        )
    here = np.unique(part[seeds])
    whole = len(here) <= 1 and driven[here].all()
    floating = np.flatnonzero(taking & ~(low | high)[part])
    return floating, "" if whole else "the changed cells leave the circuit in parts"


def _cut_loose(system: NodalSystem, lost: NDArray[np.int64]) -> NodalSystem:
    """Pin rows that nothing holds at the reference, each alone."""
    if not len(lost):
        return system
    gone = np.zeros(system.size, dtype=np.bool_)
    gone[lost] = True
    coupling = system.coupling.copy()
    coupling.data[np.repeat(gone, np.diff(coupling.indptr))] = 0.0
    coupling.eliminate_zeros()
    pin = np.where(system.degree > 0, system.degree, system.degree.max())[lost]
    tie = _Tie(lost[:0], pin[:0], lost, pin)
    degree, rails = system.degree.copy(), system.rails
    degree[lost] = pin
    return system.derive(
        coupling,
        tie.of(system.excess, 1.0),
        degree,
        feed=tie.of(system.feed, 0.0),
        rails=rails and replace(rails, ties=partial(_tied, rails, tie, False)),
    )


def _driven_again(system: NodalSystem, rows: NDArray[np.int64]) -> tuple[NodalSystem, float]:
    """Feed nothing into rows that no longer take part; a uniform drive goes into the others, raised by a factor."""
    if not system.injected.any():
        return system, 1.0
    gain, cell_map = 1.0, system.netlist.cells
    if cell_map is not None and cell_map.wiring.drive == "uniform":
        count = np.count_nonzero(system.injected)
        gain = count / (count - np.count_nonzero(system.injected[rows]))
    injected = gain * system.injected
    injected[rows] = 0.0
    return replace(system, injected=injected), gain
