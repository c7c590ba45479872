"""What a robot knows: where it believes to be, and the map with its field."""

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
    """Tells the robot where it is: off by a bias, and by at most some noise, anew each time.

    `bias` (ndim,): along the axes; `noise` (ndim,): along the world's.
    """

    def __init__(self, plant: Plant, bias: Vector, noise: Vector, rng: np.random.Generator) -> None:
        self._plant, self.bias, self.noise, self._rng = plant, plant.frame.turned_from_world(bias), noise, rng

    @property
    def exact(self) -> bool:
        """Whether the robot knows where it is."""
        return not (self.bias.any() or self.noise.any())

    def believed(self, configurations: Vector) -> Vector:
        """Where the robot believes to be, but for noise.  Shapes: (..., ndim)."""
        return self._plant.within_stops(configurations + self.bias)

    def sense(self, configuration: Vector) -> Vector:
        """Where the robot believes to be, shape (ndim,)."""
        if not self.noise.any():
            return self.believed(configuration)
        error = self.noise * self._rng.uniform(-1.0, 1.0, len(self.noise))
        return self._plant.within_stops(configuration + self.bias + self._plant.frame.turned_from_world(error))


class LiveMap:
    """The map that the robot goes by, and the controller on its field: solved at once, or on a grid that relaxes."""

    def __init__(self, controller: Controller, grid: RelaxingGrid | None = None) -> None:
        self.space: ConfigurationSpace = controller.field.space
        self.controller = controller if grid is None else controller.with_field(grid.field)
        self.grid, self._read_at = grid, 0.0

    @property
    def spacing(self) -> Vector:
        """Widths of a cell, shape (ndim,)."""
        return self.space.spacing

    def read(self, time: float) -> None:
        """Let the grid relax until a time, and read it anew where it has moved."""
        if self.grid is None:
            return
        crossed = (time - self._read_at) * self.controller.speed / float(self.spacing.min())
        self._read_at = time
        if self.grid.advance(crossed):
            self.controller = self.controller.with_field(self.grid.field)

    def mark(self, cells: NDArray[np.bool_]) -> None:
        """Mark cells as obstacle, goal cells among them; the field is left as it is.  Shapes: `cells` as the space."""
        self.space = self.space.with_cells(np.where(cells, np.uint8(Cell.OBSTACLE), self.space.cell))

    def solve(self) -> None:
        """Solve the present map: at once, or on the grid that settles; a map that carries no current has no grid."""
        if not self.space.goal_connected.any():
            self.grid = None
        if self.grid is None:
            self.controller = self.controller.with_field(solve_again(self.controller.field, self.space))
            return
        self.grid.change(self.space)
        self.controller = self.controller.with_field(self.grid.field)


def solve_again(field: Field, space: ConfigurationSpace) -> Field:
    """The field of a changed space, wired and blended as another was."""
    return solve_field(space, field.wiring, field.k if field.boundary == "blend" else None)
