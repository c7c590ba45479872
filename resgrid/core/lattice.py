"""The abstract class `Lattice`, sites over a space with steps to neighbours, and a check for the lattice "square"."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from math import prod
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from resgrid.core.space import ConfigurationSpace
from resgrid.errors import InputError

LatticeName = Literal["square", "square8", "cube26", "hexagonal"]

SQUARE: LatticeName = "square"
"""Name of the default lattice, with face neighbours, which `resgrid.core.compiler` compiles."""

Index = tuple[NDArray[np.int64], ...]
"""Indices of several sites or cells: one array of indices per axis."""


@dataclass(frozen=True, eq=False)
class Lattice(ABC):
    """Sites, the positions of nodes, over a space, and the steps from a site to its neighbours.

    `space`: the space; `name`: name of the lattice; `shape`: number of sites along every axis of the lattice;
    `steps` (n, ndim): displacements to half of the neighbours, in axis units; displacements to the other neighbours are
    the negatives of `steps`; `weights` (n,): weight of every step far from obstacles.  A weight is the conductance of
    the resistor along the step times ``wiring.resistance``, at conductivity 1.
    """

    space: ConfigurationSpace
    name: LatticeName
    shape: tuple[int, ...]
    steps: NDArray[np.float64]
    weights: NDArray[np.float64]

    @property
    def size(self) -> int:
        """Number of sites."""
        return prod(self.shape)

    @property
    def directions(self) -> list[tuple[int, int]]:
        """Pairs (index of the step, sense), step by step: sense 1 for the step, then -1 for its negative."""
        return [(step, sense) for step in range(len(self.steps)) for sense in (1, -1)]

    @abstractmethod
    def points(self, site: ArrayLike) -> NDArray[np.float64]:
        """Return the points of sites in axis units, (..., ndim); `site` (..., ndim): indices of sites."""

    @abstractmethod
    def cells(self, site: ArrayLike) -> NDArray[np.int64]:
        """Return the cells that contain sites, (..., ndim); `site` (..., ndim): indices of sites."""

    def points_of(self, number: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the points of sites in axis units, (n, ndim); `number` (n,): flat indices of sites."""
        return self.points(np.stack(np.unravel_index(number, self.shape), axis=1))

    @abstractmethod
    def beyond(self, step: int, sense: int) -> Index:
        """Return the indices of the neighbours of all sites in one direction; they may lie outside the lattice.

        The result has one array per axis, which broadcasts to the lattice's shape.  Periodic axes are not wrapped.

        `step`: index of the step; `sense`: 1 for the step, -1 for its negative.
        """

    @abstractmethod
    def weights_at(self, step: int) -> NDArray[np.float64]:
        """Return the weight of the step with index `step` from every site, in the lattice's shape.

        A weight is a conductance times ``wiring.resistance``, at conductivity 1.  The weight is 0 where the straight
        segment of the step touches an obstacle cell or leaves the grid.
        """

    @abstractmethod
    def conductivity_at(self, step: int) -> NDArray[np.float64] | None:
        """Return the harmonic mean of the conductivity along the step `step` from every site, in the lattice's shape.

        None if the space has no conductivities; every conductivity is then 1.
        """

    @abstractmethod
    def contact_weight(self, step: int) -> float:
        """Return the weight of the resistor to the obstacle rail that replaces a step that an obstacle blocks.

        The weight is the conductance times ``wiring.resistance``, at conductivity 1; 0 if no resistor replaces the
        step.  `step`: index of the step.
        """

    @abstractmethod
    def sites_in(self, cell: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the indices of the sites in a cell, (n, ndim), in C order; `cell` (ndim,): index of the cell."""

    def nearest(self, cell: NDArray[np.int64], point: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return the index (ndim,) of the site of a cell nearest to a point; the first in C order of equally near ones.

        `cell` (ndim,): index of the cell; `point` (ndim,): a point of the cell, in axis units.
        """
        sites = self.sites_in(cell)
        distance = np.linalg.norm(self.points(sites) - point, axis=1)
        near = distance <= distance.min() + 1e-9 * float(self.space.spacing.min())
        return np.asarray(sites[int(np.argmax(near))])

    def neighbours(self, step: int, sense: int = 1) -> NDArray[np.int64]:
        """Return the flat indices of the neighbours of all sites in one direction, -1 outside, in the lattice's shape.

        `step`: index of the step; `sense`: 1 for the step, -1 for its negative.
        """
        index, inside = self._wrapped(self.beyond(step, sense))
        return np.where(inside, np.ravel_multi_index(index, self.shape), -1)

    def outside(self, step: int, sense: int, axis: int) -> NDArray[np.bool_]:
        """Return whether the neighbour of every site in one direction lies beyond an end of an axis.

        The result has the lattice's shape, and is False for a periodic axis.  `step`: index of the step; `sense`: 1 for
        the step, -1 for its negative; `axis`: index of the axis.
        """
        along = self.beyond(step, sense)[axis]
        beyond = (along < 0) | (along >= self.shape[axis])
        return np.asarray(np.broadcast_to(beyond & (not self.space.axes[axis].periodic), self.shape))

    def _wrapped(self, index: Index) -> tuple[Index, NDArray[np.bool_]]:
        """Return indices of sites wrapped on periodic axes, and whether the sites lie inside the lattice, in its shape.

        The index along an axis is 0 if a site lies beyond an end of this axis.  `index`: one array per axis.
        """
        inside = np.ones(self.shape, dtype=np.bool_)
        parts = []
        for along, size, axis in zip(index, self.shape, self.space.axes, strict=True):
            within = (along >= 0) & (along < size) | axis.periodic
            inside &= within
            parts.append(np.broadcast_to(np.where(within, np.mod(along, size), 0), self.shape))
        return tuple(parts), inside

    @cached_property
    def site_weights(self) -> NDArray[np.float64]:
        """Weights (conductance times resistance) of all steps from all sites, (steps, sites); 0 for blocked steps."""
        return np.stack([self.weights_at(step).ravel() for step in range(len(self.steps))])

    @cached_property
    def site_cells(self) -> Index:
        """Indices of the cells that contain the sites, one array of the lattice's shape per axis."""
        grid = np.moveaxis(np.indices(self.shape), 0, -1)
        return tuple(np.moveaxis(self.cells(grid), -1, 0))

    @cached_property
    def central_sites(self) -> NDArray[np.int64]:
        """Flat index of the site in each cell that is nearest to the centre of the cell, in the shape of the space."""
        cells = np.stack([along.ravel() for along in self.site_cells], axis=1)
        gap = (self.points_of(np.arange(self.size)) - self.space.axis_centre(cells)) / self.space.spacing
        number = np.ravel_multi_index(tuple(cells.T), self.space.shape)
        order = np.lexsort((np.linalg.norm(gap, axis=1).round(9), number))
        _, first = np.unique(number[order], return_index=True)
        return np.asarray(order[first].reshape(self.space.shape), dtype=np.int64)

    def at_sites(self, value: NDArray[Any]) -> NDArray[Any]:
        """Return the entries of `value` (shape of the space) for the cells that contain the sites, in lattice shape."""
        return value[self.site_cells]


def require_square(name: LatticeName, subject: str) -> None:
    """Raise InputError unless `name` is "square"; `subject`: noun phrase that begins the message."""
    if name != SQUARE:
        raise InputError(f"{subject} needs cells with face neighbours, not lattice = {name!r}; use lattice = 'square'")
