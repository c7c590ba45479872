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
    """A lattice with one site at the centre of every cell, and steps to face neighbours and across edges and corners.

    Fields besides those of `Lattice`: `offsets` (n, ndim): steps as differences of cell indices; `plain` (n,): weights
    of the steps in the stencil of face neighbours alone, 0 for steps across edges and corners.  A weight is the
    conductance of a resistor times ``wiring.resistance``, at conductivity 1.

    The ``2**ndim`` cells that meet at a corner of cells are called a block.  A block of free and goal cells has the
    weights of the stencil; any other block has the weights of face neighbours alone.  The weight of a step is the mean
    over the blocks that contain both cells of the step.  Steps across an edge or a corner therefore exist only where at
    least one of these blocks has no obstacle.  Contacts with obstacles and edges are those of the lattice "square".
    """

    offsets: NDArray[np.int64]
    plain: NDArray[np.float64]

    def points(self, site: ArrayLike) -> NDArray[np.float64]:
        """Return cell centres in axis units, (..., ndim); `site` (..., ndim): indices of cells."""
        return self.space.axis_centre(site)

    def cells(self, site: ArrayLike) -> NDArray[np.int64]:
        """Return the cells that contain sites: `site` (..., ndim) itself, since a site has the index of its cell."""
        return np.asarray(site, dtype=np.int64)

    def beyond(self, step: int, sense: int) -> Index:
        """Return the indices of the neighbours of all cells in one direction; they may lie outside the grid.

        The result has one array per axis, which broadcasts to the shape of the space.  Periodic axes are not wrapped.
        `step`: index of the step; `sense`: 1 for the step, -1 for its negative.
        """
        return tuple(
            index + sense * int(offset)
            for index, offset in zip(np.indices(self.shape, sparse=True), self.offsets[step], strict=True)
        )

    def weights_at(self, step: int) -> NDArray[np.float64]:
        """Return the weight of the step with index `step` from every cell, in the shape of the space.

        A weight is a conductance times ``wiring.resistance``, at conductivity 1.  It is 0 if one of the two cells of
        the step is an obstacle or lies outside the grid.  Otherwise it is the mean over the blocks, the ``2**ndim``
        cells around a corner, that contain both cells.  A block of free and goal cells gives the weight of the stencil,
        any other block the weight in the stencil of face neighbours alone.
        """
        open_blocks = self._open_blocks(self.offsets[step])
        weight = self.weights[step] * open_blocks + self.plain[step] * (1.0 - open_blocks)
        there, solid = self.neighbours(step), self.space.cell == Cell.OBSTACLE
        return np.where((there < 0) | solid | solid.ravel()[there], 0.0, weight)

    def conductivity_at(self, step: int) -> NDArray[np.float64] | None:
        """Return the harmonic mean of the conductivities of every cell and its neighbour, in the shape of the space.

        If only one of the two cells is free, the result is the conductivity of the free cell.  Entries for neighbours
        outside the grid have no meaning.  None if the space has no conductivities.  `step`: index of the step from the
        cell to the neighbour.
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
        """Return the weight of the resistor to the obstacle rail that replaces a step that an obstacle blocks.

        The weight is the conductance times ``wiring.resistance``, at conductivity 1: ``(h_ref / h_a)**2`` across a face
        perpendicular to axis a, with the cell widths ``h_a`` and the smallest width ``h_ref``.  It is 0 for a step
        across an edge or a corner of cells, which no resistor replaces.  `step`: index of the step.
        """
        return float(self.plain[step])

    def _open_blocks(self, offset: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return, in the shape of the space, the fraction of blocks without obstacles around a cell and its neighbour.

        A block is the ``2**ndim`` cells around a corner.  The fraction is taken of all blocks that contain both cells;
        blocks that reach beyond the grid count as blocked.  `offset` (ndim,): index of the neighbour minus the index of
        the cell, per axis.
        """
        total, count = np.zeros(self.shape), 0
        choices = [(0, 1) if by == 0 else (1,) if by > 0 else (0,) for by in offset.tolist()]
        for corner in product(*choices):
            total += self._blocks[tuple(slice(by, by + size) for by, size in zip(corner, self.shape, strict=True))]
            count += 1
        return total / count

    @cached_property
    def _blocks(self) -> NDArray[np.bool_]:
        """Whether the block of ``2**ndim`` cells around every corner of cells has no obstacle and lies inside the grid.

        The shape is that of the space plus one along every axis; entry ``i`` is the lower corner of cell ``i``.
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
    """Return the lattice `name` over a space: "square8" for two axes, or "cube26" for three axes."""
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

    The neighbours ``j`` of a cell are all cells that share a face, an edge or a corner with the cell; ``h_ref`` is the
    smallest cell width.  On a ring of a single cell, a step along the ring leads back to the cell: offsets along the
    ring become 0, and the weights of equal offsets are added.  Raise InputError unless all weights are positive.
    `name`: name of the lattice, for the message.
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
    """Return the coefficient of a neighbour of a cell in a stencil with nine or 27 points for ``h_ref**2 lap``.

    The stencil is a sum over sets ``S`` of one, two or three axes: the product of the second differences along the axes
    of ``S``, times the sum of their `a`, times 1, 1/12 or 1/90.  The product for ``S`` contributes to every neighbour
    whose index differs along axes of ``S`` only, by the factor ``(-2)**(number of axes of S with equal index)``.

    `moves` (ndim,): mask of the axes along which the index of the neighbour differs; `a` (ndim,): ``(h_ref / h)**2`` of
    every axis.
    """
    ndim, total = len(a), 0.0
    for chosen in product((False, True), repeat=ndim):
        axes = np.array(chosen)
        if np.any(moves & ~axes):
            continue
        factor = {1: 1.0, 2: 1.0 / 12.0, 3: 1.0 / 90.0}.get(int(axes.sum()), 0.0) * float(a[axes].sum())
        total += factor * (-2.0) ** int(np.count_nonzero(axes & ~moves))
    return total
