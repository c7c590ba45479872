"""Who preconditions on several threads: the same digits as on one, whatever their number.

The finest grids are cut into slabs (`resgrid.solvers.multigrid.slabs`); levels below are too small to be worth a wait.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.solvers.multigrid import atomics, slabs
from resgrid.solvers.multigrid.cycle import precondition_slabs
from resgrid.solvers.multigrid.levels import CHUNK, Finest, Levels, stencil_at
from resgrid.solvers.multigrid.red_black import Stencil
from resgrid.solvers.multigrid.sweeps import Slab
from resgrid.solvers.team import Team

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

_LEAST = 60_000
"""Slots of a colour from which a grid is cut."""

_THICK = 4
"""Blocks of a slab, at least, in units of those that red cells go ahead of black ones: a neighbour finds these too."""


class SlabSolver:
    """What preconditions on the slabs of a grid's levels, for one solve.

    `before` (slots,): the residual, relaxed: slabs read what their neighbours had before they write.
    """

    def __init__(self, team: Team, true: Stencil, finest: Finest, levels: Levels, parts: list[list[Slab]]) -> None:
        self._team, self._true, self._levels, self._parts = team, true, levels, parts
        self.before = np.zeros(len(true.black_degree), dtype=np.float32)
        slots = [len(self.before), *np.diff(levels.grids.slots).tolist()]
        room = [len(some) * count for some, count in zip(parts, slots, strict=False)]
        table = np.zeros((len(parts), max(map(len, parts)), 4), dtype=np.int64)
        for level, some in enumerate(parts):
            table[level, : len(some)] = some
        couplings = max(len(true.couplings), len(levels.grids.couplings))
        nothing = np.empty(0, dtype=np.float32)
        self._crew = slabs.Crew(
            finest=finest,
            vectors=(self.before, nothing, nothing, nothing, nothing),
            state=np.zeros(atomics.PLACES, dtype=np.int64),
            slabs=table,
            cuts=np.array([len(some) for some in parts]),
            own=np.zeros(sum(room), dtype=np.float32),
            own_at=np.cumsum([0, *room]),
            noted=np.empty(couplings, dtype=np.float32),
            noted_exact=np.empty(len(true.couplings)),
            sums=np.empty((-(-len(self.before) // min(true.block, CHUNK)), 3)),
            shares=np.empty(2),
        )

    def residual(self, b: Floats, x: Floats, r: Floats) -> float:
        """As `sweeps.black_residual`."""
        noted, squares, parts = np.empty(len(self._true.couplings)), np.empty(_blocks(self._true)), self._parts[0]
        self._team.share(lambda k: slabs.residual_part(self._true, b, x, r, parts[k], noted, squares), len(parts))
        return float(slabs.norm_of_residual(self._true, noted, squares, r))

    def precondition(self, r: Singles, s: Singles, z: Singles, w: Singles) -> tuple[float, float, float]:
        """As `cycle.precondition`, from `before` into ``z``."""
        crew = self._crew._replace(vectors=(self.before, r, s, z, w))
        products: list[float] = []
        atomics.begin_jobs(crew.state)

        def part(number: int) -> None:
            if number:
                slabs.help_sweep(crew, self._levels)
            else:
                products.extend(precondition_slabs(crew, self._levels))

        self._team.share(part, self._team.size)
        rest, product, gamma = products
        return rest, product, gamma


def slab_solver(team: Team, true: Stencil, finest: Finest, levels: Levels) -> SlabSolver | None:
    """Who preconditions on a team's threads; None where the grid is too small to be cut."""
    parts = _cut(team.size, finest, levels)
    return SlabSolver(team, true, finest, levels, parts) if parts else None


def _cut(size: int, finest: Finest, levels: Levels) -> list[list[Slab]]:
    """Slabs of the levels that are large enough and lead to another grid, whose nodes no two slabs share."""
    made: list[list[Slab]] = []
    grid: Any = stencil_at
    for level in range(len(levels.grids.margin)):
        stencil = grid.py_func(levels.grids, level - 1) if level else finest.stencil
        parts = slabs_of(stencil, size)
        if stencil.faces.shape[1] < _LEAST or len(parts) < 2:
            break
        made.append(parts)
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
