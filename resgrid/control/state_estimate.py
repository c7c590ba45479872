"""State of the robot's knowledge: the believed configuration, and the map with its field."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.control.controller import Controller
from resgrid.control.plant import Plant
from resgrid.control.relaxation import RelaxingGrid
from resgrid.core.space import Cell, ConfigurationSpace
from resgrid.planning.fields import Field
from resgrid.planning.pipeline import solve_field

Vector = NDArray[np.float64]


class Sensor:
    """Position sensor with a constant bias and bounded noise.

    `bias` (ndim,): constant error along the axes, given in world coordinates; `noise` (ndim,): largest random error of
    a measurement, in world coordinates.
    """

    def __init__(self, plant: Plant, bias: Vector, noise: Vector, rng: np.random.Generator) -> None:
        self._plant, self.bias, self.noise, self._rng = plant, plant.frame.turned_from_world(bias), noise, rng

    @property
    def exact(self) -> bool:
        """Whether the sensor has no error."""
        return not (self.bias.any() or self.noise.any())

    def believed(self, configurations: Vector) -> Vector:
        """Return the believed configurations without noise.  Shapes: (..., ndim)."""
        return self._plant.within_stops(configurations + self.bias)

    def sense(self, configuration: Vector) -> Vector:
        """Return a measurement of a configuration, shape (ndim,)."""
        if not self.noise.any():
            return self.believed(configuration)
        error = self.noise * self._rng.uniform(-1.0, 1.0, len(self.noise))
        return self._plant.within_stops(configuration + self.bias + self._plant.frame.turned_from_world(error))


class LiveMap:
    """The robot's map and the controller on its field, which is solved at once or on a relaxing grid."""

    def __init__(self, controller: Controller, grid: RelaxingGrid | None = None) -> None:
        self.space: ConfigurationSpace = controller.field.space
        self.controller = controller if grid is None else controller.with_field(grid.field)
        self.grid, self._read_at = grid, 0.0

    @property
    def spacing(self) -> Vector:
        """Cell widths, shape (ndim,)."""
        return self.space.spacing

    def read(self, time: float) -> None:
        """Let the grid relax until a time, in seconds, and update the field if it has changed."""
        if self.grid is None:
            return
        crossed = (time - self._read_at) * self.controller.speed / float(self.spacing.min())
        self._read_at = time
        if self.grid.advance(crossed):
            self.controller = self.controller.with_field(self.grid.field)

    def mark(self, cells: NDArray[np.bool_]) -> None:
        """Mark cells as obstacles, goal cells included; the field does not change.  Shapes: `cells` as the space."""
        self.space = self.space.with_cells(np.where(cells, np.uint8(Cell.OBSTACLE), self.space.cell))

    def solve(self) -> None:
        """Solve the present map, at once or on the relaxing grid; a map without current needs no grid."""
        if not self.space.goal_connected.any():
            self.grid = None
        if self.grid is None:
            self.controller = self.controller.with_field(solve_again(self.controller.field, self.space))
            return
        self.grid.change(self.space)
        self.controller = self.controller.with_field(self.grid.field)


def solve_again(field: Field, space: ConfigurationSpace) -> Field:
    """Return the field of a changed space, with the wiring and blend of another field."""
    return solve_field(space, field.wiring, field.k if field.boundary == "blend" else None)
