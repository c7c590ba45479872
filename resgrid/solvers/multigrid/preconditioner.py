"""What preconditions a grid, on one thread or several: the same digits, whatever their number.

The finest grids are cut into slabs (`resgrid.solvers.multigrid.sweeps`); levels below are too small to be worth a wait.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from resgrid.jit import ZERO, inner_fast, kernel
from resgrid.solvers.multigrid import atomics
from resgrid.solvers.multigrid.cycle import ENOUGH, help_sweep, precondition_grid
from resgrid.solvers.multigrid.graph_sweeps import work_space
from resgrid.solvers.multigrid.krylov import norm
from resgrid.solvers.multigrid.levels import CHUNK, GRID, Finest, GridLevel, Levels, Slab, values_in_window
from resgrid.solvers.multigrid.red_black import BLACK, RED, Floats, Reals, Singles, Stencil, products, relax
from resgrid.solvers.team import ALONE, Team

_LEAST = 60_000
"""Slots of a colour from which a grid is cut."""

_THICK = 4
"""Blocks of a slab, at least, in units of those that red cells go ahead of black ones: a neighbour finds these too."""


class GridPreconditioner:
    """What preconditions the black cells of a grid on the slabs of its levels, for one solve.

    `before` (slots,): the residual, relaxed: slabs read what their neighbours had before they write; None where there
    is one slab, and the residual is relaxed where the answer will be.
    """

    def __init__(self, finest: Finest, levels: Levels, team: Team = ALONE) -> None:
        self._team, self._true, self._graphs, self._work = team, finest.true, levels.graphs, work_space(levels.graphs)
        self.state = np.zeros(atomics.PLACES, dtype=np.int64)
        grids = (GridLevel(finest.stencil, finest.degree, finest.way), *levels.grids)
        slots = [len(of.degree) for of in grids]
        cuts = [slabs_of(of.stencil, team.size) for of in grids[:-1]]
        cuts.append(slabs_of(grids[-1].stencil, 1))  # nodes of a graph may have parts in several slabs
        self._parts = cuts[0]
        noted = np.empty(max(len(of.stencil.couplings) for of in grids))
        sums, shares = np.empty((-(-slots[0] // min(finest.stencil.block, CHUNK)), 3)), np.empty(2)
        self._kept: list[NDArray[np.generic]] = [noted, sums, shares]
        self.table = np.zeros(len(grids), dtype=GRID)
        fed = [np.zeros((2, count), dtype=np.float32) for count in slots[1:]]
        answers = [np.zeros((2, count), dtype=np.float32) for count in slots[1:]]
        below = [*zip(fed, answers, strict=True), (self._work.b[: 1 + self._graphs.first[1]], self._work.x)]
        for number, (row, of, cut) in enumerate(zip(self.table, grids, cuts, strict=True)):
            self._fill(row, of, cut, below[number])
            self._note(row, noted=noted, sums=sums, shares=shares)
            if number:
                (red_fed, black_fed), (red, before) = fed[number - 1], answers[number - 1]
                r, s, z, w, c = np.zeros((5, slots[number]), dtype=np.float32)
                self._note(row, red_fed=red_fed, black_fed=black_fed, red=red, before=before, r=r, s=s, z=z, w=w, c=c)
        numbers = 2 + int((self.table["window"] + self.table["joined"] + self.table["block"]).max())
        self._rooms = np.zeros((max(len(cut) for cut in cuts), 2 * numbers))
        for row, cut in zip(self.table, cuts, strict=True):
            slabs = [(*slab[:-1], room.ctypes.data) for slab, room in zip(cut, self._rooms, strict=False)]
            self._note(row, slabs=np.array(slabs))
        self.before = np.zeros(slots[0], dtype=np.float32) if len(cuts[0]) > 1 else None

    def _fill(self, row: np.void, of: GridLevel, cut: list[Slab], below: tuple[Singles, Singles]) -> None:
        """Describe a grid by its row of the table."""
        stencil, (aggregate, weight) = of.stencil, of.way
        sides, slots = stencil.faces.shape
        counts = {
            "slots": slots, "sides": sides, "margin": stencil.margin, "block": stencil.block,
            "blocks": blocks_of(stencil), "joined": len(stencil.couplings), "weighted": len(weight) > 0,
            "below_slots": below[0].size, "window": values_in_window(stencil), "parts": len(cut),
        }  # fmt: skip
        for name, count in counts.items():
            row[name] = count
        names = ("faces", "distance", "off_red", "off_black", "couplings", "red_inverse", "black_inverse")
        self._note(row, **{name: getattr(stencil, name) for name in names})
        own = np.zeros((len(cut) if len(cut) > 1 else 0, slots), dtype=np.float32)
        self._note(row, degree=of.degree, aggregate=aggregate, weight=weight, own=own)
        self._note(row, below_fed=below[0], below=below[1])

    def _note(self, row: np.void, **arrays: NDArray[np.generic]) -> None:
        """Write addresses of arrays, and keep these."""
        for name, array in arrays.items():
            assert array.flags.c_contiguous
            row[name] = array.ctypes.data
            self._kept.append(array)

    def __call__(
        self, r: Singles, s: Singles, z: Singles, w: Singles, stop: float = ENOUGH
    ) -> tuple[float, float, float]:
        """Precondition ``r`` into ``z``, and multiply into ``w``; `cycle.precondition_grid` says the rest."""
        self.use(r, s, z, w)
        if self.before is None:
            return self._lead(stop)
        margin, made = int(self.table["margin"][0]), list[float]()
        z[:margin], z[len(z) - margin :] = 0.0, 0.0
        atomics.begin_jobs(self.state)

        def part(number: int) -> None:  # keeps what the table points to, whoever is interrupted
            if number:
                help_sweep(self.table, self.state)
            else:
                made.extend(self._lead(stop))

        self._team.share(part, self._team.size)
        rest, product, gamma = made
        return rest, product, gamma

    def _lead(self, stop: float) -> tuple[float, float, float]:
        return precondition_grid(self.table, self.state, self._graphs, self._work, stop)

    def use(self, r: Singles, s: Singles, z: Singles, w: Singles) -> None:
        """Let the finest level have these vectors."""
        self._vectors = {"before": z if self.before is None else self.before, "r": r, "s": s, "z": z, "w": w}
        for name, vector in self._vectors.items():
            self.table[name][0] = vector.ctypes.data

    def residual(self, b: Floats, x: Floats, r: Floats) -> float:
        """As `black_residual`, on the team's threads."""
        return black_residual(self._true, b, x, r, self._parts, self._team)


def black_residual(
    stencil: Stencil, b: Floats, x: Floats, r: Floats, parts: list[Slab] | None = None, team: Team = ALONE
) -> float:
    """Relax the red cells exactly, and form the residual ``r`` at the black ones; returns its norm.

    Shapes: `b, x` (2, slots), `r` (slots,).
    """
    parts = slabs_of(stencil, 1) if parts is None else parts
    squares, margin = np.empty(blocks_of(stencil)), int(stencil.margin)
    for colour in (RED, BLACK):

        def sweep(part: int, of: int = colour) -> None:
            sweep_colour(stencil, of, b, x, r, squares, np.empty(stencil.block), parts[part][:2])

        team.share(sweep, len(parts))
    r[:margin], r[len(r) - margin :] = 0.0, 0.0
    if not len(stencil.couplings):
        return math.sqrt(squares.sum())
    np.add.at(r, stencil.off_black, stencil.couplings * x[0, stencil.off_red])
    return norm(r)


@kernel
def sweep_colour(
    stencil: Stencil, colour: int, b: Floats, x: Floats, r: Floats, squares: Floats, total: Floats,
    blocks: tuple[int, int],
) -> None:  # fmt: skip
    """Relax the red cells of some blocks exactly, or form the residual at the black ones, but for couplings.

    ``squares`` receives those of every block, summed; ``total`` (block,) is room.
    """
    there, margin, coupling, (first, last) = x[1 - colour], stencil.margin, 0, blocks
    while coupling < len(stencil.couplings) and stencil.off_red[coupling] < margin + first * stencil.block:
        coupling += 1
    for block in range(first, last):
        at = margin + block * stencil.block
        count = min(stencil.block, stencil.faces.shape[1] - margin - at)
        products(stencil.faces, stencil.distance, (colour, at, count), there, at, total, ZERO)
        if colour == BLACK:
            squares[block] = _subtract(stencil.black_degree, b[1], x[1], at, count, total, r)
            continue
        while coupling < len(stencil.couplings) and stencil.off_red[coupling] < at + count:
            total[stencil.off_red[coupling] - at] += stencil.couplings[coupling] * there[stencil.off_black[coupling]]
            coupling += 1
        relax(stencil.red_inverse, b[0], at, count, total, x[0])


@inner_fast
def _subtract(degree: Reals, b: Reals, x: Reals, begin: int, count: int, total: Reals, r: Reals) -> float:
    """``r = b + total - degree x`` on a block; returns its squares, summed."""
    squares = 0.0
    at = np.uint64(begin)
    for i in range(count):
        k = at + np.uint64(i)
        v = b[k] + (total[np.uint64(i)] - degree[k] * x[k])
        r[k] = v
        squares += v * v
    return squares


def slabs_of(stencil: Stencil, most: int) -> list[Slab]:
    """Cut a stencil into so many slabs, or fewer; small ones are not cut.

    No slab is thinner than what its neighbours find of it too, twice.  Nodes of the next level are parts of blocks that
    begin at even indices along the first axis; two rows along it take a stride of slots.
    """
    margin, blocks, slots = stencil.margin, blocks_of(stencil), stencil.faces.shape[1]
    count = min(most, int(blocks // (_THICK * -(-margin // stencil.block)))) if slots >= _LEAST else 1
    if count < 2:
        return [Slab(0, blocks, int(margin), int(slots - margin))]
    stride, end = int(stencil.distance[1] - stencil.distance[0]), stencil.first_extra

    def from_even_row(block: int) -> int:
        return min(int(margin) - (-(block * stencil.block) // stride) * stride, end)

    borders = [blocks * k // count for k in range(count + 1)]
    begins = [from_even_row(block) for block in borders[:-1]] + [end]
    return [Slab(*borders[k : k + 2], *begins[k : k + 2]) for k in range(count)]


def blocks_of(stencil: Stencil) -> int:
    """How many blocks there are."""
    return int(-(-(stencil.faces.shape[1] - 2 * stencil.margin) // stencil.block))
