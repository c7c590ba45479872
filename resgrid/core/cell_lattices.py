"""Lattices with one node per cell: nine-point stencils of planes and 27-point stencils of spaces with three axes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.core.cell import Cell
from resgrid.core.lattice import Index, Lattice, LatticeName
from resgrid.core.regions import with_margin
from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError


@dataclass(frozen=True, eq=False)
class CellLattice(Lattice):
    """One site per cell, with steps to face neighbours and across edges and corners of cells.

    `offsets` (n, ndim): steps as differences of cell indices; `plain` (n,): weights of the steps in the stencil of face
    neighbours alone, 0 for steps across edges and corners.

    The ``2**ndim`` cells that meet at a corner of cells are called a block.  A block of free and goal cells has the
    weights of the stencil; any other block has the weights of face neighbours alone.  The weight of a step is the mean
    over the blocks that contain its two cells.  Steps across an edge or a corner therefore exist only where at least
    one of these blocks has no obstacle, and contacts with obstacles and edges are those of the lattice "square".
    """

    offsets: NDArray[np.int64]
    plain: NDArray[np.float64]

    def points(self, site: ArrayLike) -> NDArray[np.float64]:
        """Return cell centres in axis units, (..., ndim); `site` (..., ndim): indices of cells."""
        return self.space.axis_centre(site)

    def cells(self, site: ArrayLike) -> NDArray[np.int64]:
        """Return `site` (..., ndim), since sites are numbered like cells."""
        return np.asarray(site, dtype=np.int64)

    def beyond(self, step: int, sense: int) -> Index:
        """Return the indices of the neighbours of all cells in one direction; they may lie outside the grid.

        `step`: index of the step; `sense`: 1 for the step, -1 for its negative.
        """
        return tuple(
            index + sense * int(offset)
            for index, offset in zip(np.indices(self.shape, sparse=True), self.offsets[step], strict=True)
        )

    def weights_at(self, step: int) -> NDArray[np.float64]:
        """Return the weight of a step from every cell, in the shape of the space.

        It is the mean of the weights that the blocks with both cells give to the step; 0 if one of the cells is an
        obstacle or lies outside the grid.
        """
        open_blocks = self._open_blocks(self.offsets[step])
        weight = self.weights[step] * open_blocks + self.plain[step] * (1.0 - open_blocks)
        there, solid = self.neighbours(step), self.space.cell == Cell.OBSTACLE
        return np.where((there < 0) | solid | solid.ravel()[there], 0.0, weight)

    def conductivity_at(self, step: int) -> NDArray[np.float64] | None:
        """Return the harmonic mean of the conductivities of every cell and its neighbour along a step.

        If only one of the two cells is free, return its conductivity.  None if the space has no conductivities.
        Entries for neighbours outside the grid have no meaning.
        """
        c = self.space.conductivity
        if c is None:
            return None
        there = self.neighbours(step)
        free = self.space.cell == Cell.FREE
        here, beyond, is_free = c, c.ravel()[there], free.ravel()[there]
        here, beyond = np.where(is_free & ~free, beyond, here), np.where(free & ~is_free, here, beyond)
        return np.asarray(here * (2.0 * beyond / (here + beyond)))

    def contact_weight(self, step: int) -> float:
        """Return the weight of a contact: the conductance to the obstacle in place of a blocked step, times R.

        It is ``(h_ref / h_a)**2`` across a face of axis a, and 0 for steps across edges and corners of cells, which
        have no contact.
        """
        return float(self.plain[step])

    def _open_blocks(self, offset: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return, for every cell, the fraction of blocks without obstacles among the blocks with it and its neighbour.

        The result has the shape of the space; blocks that reach beyond the grid count as blocked.  `offset` (ndim,):
        index of the neighbour minus that of the cell, per axis.
        """
        total, count = np.zeros(self.shape), 0
        choices = [(0, 1) if by == 0 else (1,) if by > 0 else (0,) for by in offset.tolist()]
        for corner in product(*choices):
            total += self._blocks[tuple(slice(by, by + size) for by, size in zip(corner, self.shape, strict=True))]
            count += 1
        return total / count

    @cached_property
    def _blocks(self) -> NDArray[np.bool_]:
        """Whether the block of cells around every corner of a cell has no obstacle and lies inside the grid.

        The shape is that of the space plus one along every axis.
        """
        wide = with_margin(self.space.cell != Cell.OBSTACLE, self.space.periodic, beyond=False)
        clear = np.ones([size + 1 for size in self.shape], dtype=np.bool_)
        for corner in product((0, 1), repeat=self.space.ndim):
            clear &= wide[tuple(slice(by, by + size + 1) for by, size in zip(corner, self.shape, strict=True))]
        return clear

    def sites_in(self, cell: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the index of the only site in a cell, (1, ndim); it equals `cell` (ndim,), the index of the cell."""
        return cell[np.newaxis].astype(np.int64)


def cell_lattice(name: LatticeName, space: ConfigurationSpace) -> CellLattice:
    """Return the lattice "square8" or "cube26" over a space."""
    stencil = stencil_of(name, space)
    offsets = [offset for offset in stencil if offset > (0,) * space.ndim]
    offsets.sort(key=lambda offset: (np.count_nonzero(offset), tuple(-by for by in offset)))
    steps = np.array(offsets, dtype=np.int64).reshape(-1, space.ndim)
    h_ref = float(space.spacing.min())
    plain = [
        (h_ref / space.spacing[axis]) ** 2 if np.count_nonzero(offset) == 1 else 0.0
        for offset, axis in zip(offsets, np.argmax(steps != 0, axis=1).tolist(), strict=True)
    ]
    weights = np.array([stencil[offset] for offset in offsets])
    return CellLattice(space, name, space.shape, steps * space.spacing, weights, steps, np.array(plain))


def stencil_of(name: LatticeName, space: ConfigurationSpace) -> dict[tuple[int, ...], float]:
    """Return the weights ``g`` of ``h_ref**2 lap f = sum_j g_j (f_j - f)``, by the neighbour's offset in cell indices.

    On a ring of a single cell, a step along the ring leads back to the cell: offsets along the ring become 0, and the
    weights of equal offsets are added.  Raise InputError unless all weights are positive.  `name`: name of the lattice,
    for the message.
    """
    h_ref = float(space.spacing.min())
    a = (h_ref / space.spacing) ** 2
    ring = np.array([axis.periodic and axis.cells == 1 for axis in space.axes])
    weights: dict[tuple[int, ...], float] = {}
    for offset in product((-1, 0, 1), repeat=space.ndim):
        weight = _coefficient(np.array(offset) != 0, a)
        folded = tuple(0 if closed else by for by, closed in zip(offset, ring.tolist(), strict=True))
        if any(folded):
            weights[folded] = weights.get(folded, 0.0) + weight
    if min(weights.values(), default=1.0) < 1e-9:
        widths = " x ".join(f"{width:g}" for width in space.spacing)
        limit = "sqrt(5) = 2.24" if space.ndim == 2 else "about 1.7"
        raise InputError(
            f"lattice = {name!r} has no positive resistances on cells of {widths}: the ratio of the widths must be "
            f"below {limit}; change the numbers of cells so that the widths are similar, or use lattice = 'square'"
        )
    return weights


def _coefficient(moves: NDArray[np.bool_], a: NDArray[np.float64]) -> float:
    """Return the coefficient of a neighbour in the stencil at the head of `resgrid.core.lattices`.

    `moves` (ndim,): mask of the axes along which the index of the neighbour differs; `a` (ndim,): ``(h_ref / h)**2`` of
    every axis.  The product of the second differences along a set ``S`` of axes contributes to every neighbour that
    differs along axes of ``S`` only: the factor is ``(-2)**(number of axes of S along which it does not differ)``.
    """
    ndim, total = len(a), 0.0
    for chosen in product((False, True), repeat=ndim):
        axes = np.array(chosen)
        if np.any(moves & ~axes):
            continue
        factor = {1: 1.0, 2: 1.0 / 12.0, 3: 1.0 / 90.0}.get(int(axes.sum()), 0.0) * float(a[axes].sum())
        total += factor * (-2.0) ** int(np.count_nonzero(axes & ~moves))
    return total
