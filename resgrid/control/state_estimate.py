"""The robot's knowledge in a simulation: its position sensor, and its map with the controller and field of the map."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from resgrid.control.controller import Controller
from resgrid.control.plant import Plant
from resgrid.control.relaxation import RelaxingGrid
from resgrid.core.cell import Cell
from resgrid.core.space import ConfigurationSpace
from resgrid.planning.fields import Field
from resgrid.planning.pipeline import solve_field

Vector = NDArray[np.float64]


class Sensor:
    """Position sensor with a constant bias and bounded noise.

    `plant`: robot and true obstacles; `bias` (ndim,): constant error, in world coordinates; `noise` (ndim,): largest
    random error of one measurement, in world coordinates; `rng`: random generator of the noise.
    """

    def __init__(self, plant: Plant, bias: Vector, noise: Vector, rng: np.random.Generator) -> None:
        self._plant, self.bias, self.noise, self._rng = plant, plant.frame.turned_from_world(bias), noise, rng

    @property
    def exact(self) -> bool:
        """Whether the sensor has neither bias nor noise."""
        return not (self.bias.any() or self.noise.any())

    def believed(self, configurations: Vector) -> Vector:
        """Return measurements of `configurations` (..., ndim) with the bias and without noise, in the same shape.

        Measurements and configurations are in axis coordinates; the result is clipped to the mechanical stops.
        """
        return self._plant.within_stops(configurations + self.bias)

    def sense(self, configuration: Vector) -> Vector:
        """Return one measurement with bias and noise of a configuration (ndim,), both in axis coordinates."""
        if not self.noise.any():
            return self.believed(configuration)
        error = self.noise * self._rng.uniform(-1.0, 1.0, len(self.noise))
        return self._plant.within_stops(configuration + self.bias + self._plant.frame.turned_from_world(error))


class LiveMap:
    """The robot's map, and the controller that follows the map's field, solved at once or on a settling grid.

    `controller`: controller with the field of the initial map; `grid`: grid whose voltages settle while the robot
    moves, None for a field that is solved at once.
    """

    def __init__(self, controller: Controller, grid: RelaxingGrid | None = None) -> None:
        self.space: ConfigurationSpace = controller.field.space
        self.controller = controller if grid is None else controller.with_field(grid.field)
        self.grid, self._read_at = grid, 0.0

    @property
    def spacing(self) -> Vector:
        """Cell width along each axis, in axis units, shape (ndim,)."""
        return self.space.spacing

    def read(self, time: float) -> None:
        """Let the grid settle until `time`, in seconds since the start of the run, and update the field.

        Without effect if the field is solved at once (no grid).
        """
        if self.grid is None:
            return
        crossed = (time - self._read_at) * self.controller.speed / float(self.spacing.min())
        self._read_at = time
        if self.grid.advance(crossed):
            self.controller = self.controller.with_field(self.grid.field)

    def mark(self, cells: NDArray[np.bool_]) -> None:
        """Mark cells as obstacles of the map, goal cells included; the field does not change.

        `cells` (shape of the space): mask of the cells.
        """
        self.space = self.space.with_cells(np.where(cells, np.uint8(Cell.OBSTACLE), self.space.cell))

    def solve(self) -> None:
        """Solve the present map and update the field, at once or, on a settling grid, over the following steps.

        A map in which no cell has a path to a goal is solved at once.
        """
        if not self.space.goal_connected.any():
            self.grid = None
        if self.grid is None:
            self.controller = self.controller.with_field(solve_again(self.controller.field, self.space))
            return
        self.grid.change(self.space)
        self.controller = self.controller.with_field(self.grid.field)


def solve_again(field: Field, space: ConfigurationSpace) -> Field:
    """Return the field of a changed map.

    `field`: field of the old map, whose wiring and Dirichlet weight k are used again; `space`: the new map.
    """
    return solve_field(space, field.wiring, field.k if field.boundary == "blend" else None)
