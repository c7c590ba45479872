"""What preconditions a grid, on one thread or several: the same digits, whatever their number.

The finest grids are cut into slabs (`resgrid.solvers.multigrid.sweeps`); levels below are too small to be worth a wait.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.jit import kernel
from resgrid.solvers.multigrid import atomics, slabs, sweeps
from resgrid.solvers.multigrid.cycle import ENOUGH, precondition_grid
from resgrid.solvers.multigrid.levels import CHUNK, BlackVectors, Finest, Levels, stencil_at
from resgrid.solvers.multigrid.red_black import Stencil
from resgrid.solvers.multigrid.windows import Slab
from resgrid.solvers.team import ALONE, Team

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

_LEAST = 60_000
"""Slots of a colour from which a grid is cut."""

_THICK = 4
"""Blocks of a slab, at least, in units of those that red cells go ahead of black ones: a neighbour finds these too."""

_NOTHING = np.empty(0, dtype=np.float32)


class GridPreconditioner:
    """What preconditions the black cells of a grid on the slabs of its levels, for one solve.

    `before` (slots,): the residual, relaxed: slabs read what their neighbours had before they write; None where there
    is one slab, and the residual is relaxed where the answer will be.
    """

    def __init__(self, finest: Finest, levels: Levels, team: Team = ALONE) -> None:
        self._team, self._graphs = team, levels.graphs
        self._places = slabs.Places(finest, BlackVectors(*[_NOTHING] * 6), levels.grids, levels.work)
        grid: Any = stencil_at
        stencils = [finest.stencil, *(grid.py_func(levels.grids, k) for k in range(len(levels.grids.margin)))]
        parts = [slabs_of(stencil, team.size) for stencil in stencils[:-1]]
        parts.append(slabs_of(stencils[-1], 1))  # nodes of a graph may have parts in several slabs
        slots = [stencil.faces.shape[1] for stencil in stencils]
        room = [len(some) * count if len(some) > 1 else 0 for some, count in zip(parts, slots, strict=True)]
        table = np.zeros((len(parts), max(map(len, parts)), 4), dtype=np.int64)
        for level, some in enumerate(parts):
            table[level, : len(some)] = some
        ends = [*(2 * levels.grids.slots[1:]), 2 * levels.grids.slots[-1] + 1 + levels.graphs.first[1]]
        sizes = [
            (len(some), _blocks(stencil), -(-count // CHUNK), end, len(stencil.couplings))
            for some, stencil, count, end in zip(parts, stencils, slots, ends, strict=True)
        ]
        own_couplings = len(finest.stencil.couplings)
        self._parts = parts[0]
        self.before = np.zeros(slots[0], dtype=np.float32) if len(parts[0]) > 1 else None
        self._crew = slabs.Crew(
            state=np.zeros(atomics.PLACES, dtype=np.int64),
            slabs=table,
            sizes=np.array(sizes),
            own=np.zeros(sum(room), dtype=np.float32),
            own_at=np.cumsum([0, *room]),
            noted=np.empty(max(own_couplings, len(levels.grids.couplings)), dtype=np.float32),
            noted_exact=np.empty(own_couplings),
            sums=np.empty((-(-slots[0] // min(finest.stencil.block, CHUNK)), 3)),
            shares=np.empty(2),
        )

    def __call__(
        self, r: Singles, s: Singles, z: Singles, w: Singles, stop: float = ENOUGH
    ) -> tuple[float, float, float]:
        """Precondition ``r`` into ``z``, and multiply into ``w``; `cycle.precondition_grid` says the rest."""
        before = z if self.before is None else self.before
        crew, places = self._crew, self._places._replace(vectors=BlackVectors(before, r, s, z, w, _NOTHING))
        if self.before is None:
            return precondition_grid(crew, places, self._graphs, stop)
        margin, products = int(places.finest.stencil.margin), list[float]()
        z[:margin], z[len(z) - margin :] = 0.0, 0.0
        atomics.begin_jobs(crew.state)

        def part(number: int) -> None:
            if number:
                slabs.help_sweep(crew, places)
            else:
                products.extend(precondition_grid(crew, places, self._graphs, stop))

        self._team.share(part, self._team.size)
        rest, product, gamma = products
        return rest, product, gamma

    def residual(self, true: Stencil, b: Floats, x: Floats, r: Floats) -> float:
        """As `black_residual`, on the team's threads."""
        return black_residual(true, b, x, r, self._parts, self._team)


def black_residual(
    stencil: Stencil, b: Floats, x: Floats, r: Floats, parts: list[Slab] | None = None, team: Team = ALONE
) -> float:
    """Relax the red cells exactly, and form the residual ``r`` at the black ones; returns its norm.

    Shapes: `b, x` (2, slots), `r` (slots,).
    """
    parts = slabs_of(stencil, 1) if parts is None else parts
    noted, squares = np.empty(len(stencil.couplings)), np.empty(_blocks(stencil))
    team.share(lambda k: residual_part(stencil, b, x, r, parts[k], noted, squares), len(parts))
    return float(norm_of_residual(stencil, noted, squares, r))


residual_part = kernel(sweeps.residual)
norm_of_residual = kernel(sweeps.residual_couplings)


def slabs_of(stencil: Stencil, most: int) -> list[Slab]:
    """Cut a stencil into so many slabs, or fewer; small ones are not cut.

    No slab is thinner than what its neighbours find of it too, twice.  Nodes of the next level are parts of blocks that
    begin at even indices along the first axis; two rows along it take a stride of slots.
    """
    margin, blocks, slots = stencil.margin, _blocks(stencil), stencil.faces.shape[1]
    count = min(most, int(blocks // (_THICK * -(-margin // stencil.block)))) if slots >= _LEAST else 1
    if count < 2:
        return [Slab(0, blocks, int(margin), int(slots - margin))]
    stride, end = int(stencil.distance[1] - stencil.distance[0]), _behind_faces(stencil)

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
