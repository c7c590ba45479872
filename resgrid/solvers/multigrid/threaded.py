"""The steps of conjugate gradients on several threads: the same digits as on one, whatever their number.

The finest grids are cut into slabs (`resgrid.solvers.multigrid.slabs`), and Python leads from sweep to sweep; levels
below, too small to be worth a wait, are left to the compiled cycle of one thread.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.solvers.multigrid import slabs
from resgrid.solvers.multigrid.cycle import CHUNK, ENOUGH, Finest, Levels, run_cycle, second_step, stencil_at
from resgrid.solvers.multigrid.red_black import Stencil
from resgrid.solvers.multigrid.sweeps import Slab
from resgrid.solvers.team import Team

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

_LEAST = 60_000
"""Slots of a colour from which a grid is cut."""

_THICK = 4
"""Blocks of a slab, at least, in units of those that red cells go ahead of black ones: a neighbour finds these too."""


@dataclass(frozen=True, eq=False)
class _Grid:
    """A level in slabs.

    `stencil, exact`: as of `Finest`; `way`: aggregates, weights, and the next level's answer; `below`: the next level's
    right-hand side; `parts`: the slabs; `own` (slabs, slots): their work space; `noted`: red values where couplings
    begin, of either stencil; `sums` (blocks, 3): of products.
    """

    stencil: Stencil
    exact: Stencil
    way: tuple[NDArray[np.int32], Singles, Singles]
    below: Singles
    parts: list[Slab]
    own: Singles
    noted: tuple[NDArray[Any], NDArray[Any]]
    sums: Floats

    @property
    def coupled(self) -> bool:
        """Whether there are couplings."""
        return len(self.stencil.couplings) > 0

    def share(self, part: int) -> Singles:
        """A share of the next level's right-hand side."""
        return self.below[slice(*_share(part, len(self.parts), len(self.below)))]


class SlabSolver:
    """What preconditions on the slabs of a grid's levels, for one solve.

    `before` (slots,): the residual, relaxed: slabs read what their neighbours had before they write.
    """

    def __init__(self, team: Team, true: Stencil, grids: list[_Grid], levels: Levels) -> None:
        self._team, self._true, self._grids, self._levels = team, true, grids, levels
        self.before = np.zeros(len(true.black_degree), dtype=np.float32)

    def residual(self, b: Floats, x: Floats, r: Floats) -> float:
        """As `sweeps.black_residual`."""
        grid, noted = self._grids[0], np.empty(len(self._true.couplings))
        squares = np.empty(len(grid.sums))
        self._each(lambda k: slabs.residual_part(self._true, b, x, r, grid.parts[k], noted, squares))
        return float(slabs.norm_of_residual(self._true, noted, squares, r))

    def precondition(self, r: Singles, s: Singles, z: Singles, w: Singles) -> tuple[float, float, float]:
        """As `cycle.precondition`, from `before` into ``z``."""
        grid, margin = self._grids[0], self._true.margin
        self._each(lambda k: grid.share(k).fill(0.0))
        z[:margin], z[-margin:] = 0.0, 0.0
        self._down(0, self.before)
        return self._up(grid, self.before, r, s, z, w)

    def _each(self, part: Any, grid: _Grid | None = None) -> None:
        self._team.share(part, len((grid or self._grids[0]).parts))

    def _down(self, index: int, z: Singles) -> None:
        """Restrict what a level leaves of ``z``, and visit the next one; its right-hand side comes as 0."""
        grid = self._grids[index]
        (aggregate, weight, _), noted = grid.way, grid.noted[0]
        self._each(
            lambda k: slabs.restrict_part(grid.stencil, aggregate, weight, z, grid.parts[k], noted, grid.below), grid
        )
        grid.below[0] = 0.0
        if grid.coupled:
            slabs.finish_restricting(grid.stencil, aggregate, weight, noted, grid.below)
        if index + 1 < len(self._grids):
            self._visit(index + 1)
        else:
            run_cycle(self._levels, ENOUGH * 2.0**index, index)

    def _up(
        self, grid: _Grid, before: Singles, r: Singles, s: Singles, z: Singles, w: Singles
    ) -> tuple[float, float, float]:
        """As `sweeps.prolong_and_multiply`, from ``before`` into ``z``."""
        noted, product = grid.noted
        self._each(
            lambda k: slabs.relax_part(grid.stencil, grid.way, r, before, grid.parts[k], grid.own[k], noted, z), grid
        )
        if grid.coupled:
            slabs.finish_relaxing(grid.stencil, noted, z)
        self._each(lambda k: slabs.multiply_part(grid.exact, z, r, s, grid.parts[k], product, w, grid.sums), grid)
        zr, zw, zs = _in_order(grid.sums)
        if grid.coupled:
            zw -= slabs.finish_multiplying(grid.exact, product, z, w)
        return zr, zw, zs

    def _visit(self, index: int) -> None:
        """One or two steps of the K-cycle on a coarse level, as `cycle.run_cycle`."""
        grid, (grids, _, work), level = self._grids[index], self._levels, index - 1
        a, e = int(grids.slots[level]), int(grids.slots[level + 1])
        r, z, c, v, w = work.f[a:e], work.z[a:e], work.c[a:e], work.v[a:e], work.w[a:e]
        red_fed, black_fed = work.b[2 * a : a + e], work.b[a + e : 2 * e]
        red, before = work.x[2 * a : a + e], work.x[a + e : 2 * e]
        stencil, parts = grid.stencil, grid.parts
        self._each(
            lambda k: slabs.eliminate_part(stencil, red_fed, black_fed, parts[k], r, before, grid.share(k)), grid
        )
        if grid.coupled:
            slabs.finish_eliminating(stencil, red_fed, r, before)
        self._down(index, before)
        alpha, energy, _ = self._up(grid, before, r, v, z, v)
        if energy > 0.0 and not self._first_step(grid, (r, z, c, v), alpha / energy, index - 1):
            self._each(
                lambda k: slabs.relax_from_zero(
                    stencil.black_inverse, r, before, *_share(k, len(parts), len(r)), grid.share(k)
                ),
                grid,
            )
            self._down(index, before)
            on_c, on_z = second_step(alpha, energy, *self._up(grid, before, r, v, z, w))
            self._each(lambda k: slabs.combine_part(z, c, on_c, on_z, *_share(k, len(parts), len(z))), grid)
        self._each(lambda k: slabs.put_back_part(stencil, z, red_fed, parts[k], red, before), grid)

    def _first_step(self, grid: _Grid, of: tuple[Singles, Singles, Singles, Singles], step: float, level: int) -> bool:
        """As `cycle.first_step`."""
        r, z, c, v = of
        count, stop = len(grid.parts), ENOUGH * 2.0**level
        sums = np.empty((-(-len(r) // CHUNK), 2))
        self._each(lambda k: slabs.take_part(r, v, step, _share(k, count, len(sums)), sums), grid)
        before, after = _in_order(sums)
        enough = not after > stop * stop * before
        self._each(lambda k: slabs.keep_part(z, c, step, enough, *_share(k, count, len(z))), grid)
        return enough


def slab_solver(team: Team, true: Stencil, finest: Finest, levels: Levels) -> SlabSolver | None:
    """Who preconditions on a team's threads; None where the grid is too small to be cut."""
    grids = _cut(team.size, finest, levels)
    return SlabSolver(team, true, grids, levels) if grids else None


def _cut(size: int, finest: Finest, levels: Levels) -> list[_Grid]:
    """The levels that are large enough, and lead to another grid: its nodes are blocks, which slabs do not share."""
    grids, _, work = levels
    made: list[_Grid] = []
    stencil, exact, aggregate, weight, _ = finest
    for level in range(len(grids.margin)):
        a, e = (2 * int(k) for k in grids.slots[level : level + 2])
        parts = slabs_of(stencil, size)
        if len(aggregate) < _LEAST or len(parts) < 2:
            break
        way = (aggregate, weight, work.x[a:e])
        couplings = len(stencil.couplings)
        noted = np.empty(couplings, np.float32), np.empty(couplings, exact.black_degree.dtype)
        own = np.zeros((len(parts), len(aggregate)), dtype=np.float32)
        sums = np.empty((_blocks(stencil), 3))
        made.append(_Grid(stencil, exact, way, work.b[a:e], parts, own, noted, sums))
        stencil = exact = stencil_at(grids, level)
        begin, end = (int(k) for k in grids.slots[level : level + 2])
        aggregate, weight = grids.aggregate[begin:end], grids.weight[begin:end]
    return made


def slabs_of(stencil: Stencil, most: int) -> list[Slab]:
    """Cut a stencil into so many slabs, or fewer: none is thinner than what its neighbours find of it too, twice.

    Nodes of the next level are parts of blocks that begin at even indices along the first axis; two rows along it take
    a stride of slots.
    """
    margin, blocks = stencil.margin, _blocks(stencil)
    stride = int(stencil.distance[1] - stencil.distance[0])
    ahead = -(-margin // stencil.block)
    count = max(1, min(most, blocks // (_THICK * ahead)))
    end = _behind_faces(stencil)

    def from_even_row(block: int) -> int:
        return min(int(margin) - (-(block * stencil.block) // stride) * stride, end)

    borders = [blocks * k // count for k in range(count + 1)]
    begins = [from_even_row(block) for block in borders[:-1]] + [end]
    return [Slab(*borders[k : k + 2], *begins[k : k + 2]) for k in range(count)]


def _behind_faces(stencil: Stencil) -> int:
    """Behind the last black slot that a face leads to: nodes beside the lattice follow, parts of blocks anywhere."""
    reach, step = int(stencil.distance.max()), 4 * stencil.block
    end = int(stencil.faces.shape[1] - stencil.margin)
    while end > stencil.margin:
        begin = max(end - step, int(stencil.margin))
        used = np.flatnonzero(stencil.faces[:, begin:end].any(axis=0))
        if len(used):
            return min(begin + int(used[-1]) + 1 + reach, int(stencil.faces.shape[1] - stencil.margin))
        end = begin
    return end


def _blocks(stencil: Stencil) -> int:
    return int(-(-(stencil.faces.shape[1] - 2 * stencil.margin) // stencil.block))


def _share(part: int, parts: int, count: int) -> tuple[int, int]:
    """The range of a part of so many things."""
    return part * count // parts, (part + 1) * count // parts


def _in_order(sums: Floats) -> list[float]:
    """Sums of the columns, one after the other as a loop adds them."""
    return [float(total) for total in np.add.accumulate(sums, axis=0)[-1]]
