"""A robot that only sees the read-out: it measures its cell and the neighbours, and steps to the lowest.

The converter floors every voltage into ``2**bits`` equal steps of its range.  The robot steps only to a strictly lower
reading; of equal ones to the first along the axes in their order, the lower side first.  Where no neighbour measures
lower it is stuck, and stuck or back in a cell it has been to, it is lost.  Every read-out of a cell keeps its offset;
noise is drawn anew for every measurement.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.die import NOISE, OFFSET, Seed, generator
from resgrid.netlist import CellMap
from resgrid.scene.chip import Readout
from resgrid.space import Cell


@dataclass(frozen=True, eq=False)
class Floor:
    """Where a robot may walk.

    `around` (cells, 2 ndim): free or goal cells that a free cell touches, -1 for none, axis by axis, the lower side
    first; `goal` (cells,); `node` (cells,): node of every cell; ground's where a cell has none.
    """

    around: NDArray[np.int64]
    goal: NDArray[np.bool_]
    node: NDArray[np.int64]


def floor_of(cell_map: CellMap) -> Floor:
    """Lay out the cells of a netlist for a walk."""
    space = cell_map.space
    open_cell = (space.cell != Cell.OBSTACLE) & (cell_map.node >= 0)
    flat = np.where(open_cell, np.arange(space.cell.size).reshape(space.shape), -1)
    ways = []
    for axis in range(space.ndim):
        for step in (1, -1):
            there = np.roll(flat, step, axis)
            if not space.axes[axis].periodic:
                np.moveaxis(there, axis, 0)[0 if step > 0 else -1] = -1
            ways.append(np.where(space.cell == Cell.FREE, there, -1).ravel())
    return Floor(
        around=np.stack(ways, axis=1),
        goal=(space.cell == Cell.GOAL).ravel(),
        node=np.where(cell_map.node >= 0, cell_map.node, 0).ravel(),
    )


@dataclass(frozen=True, eq=False)
class Eyes:
    """What a robot sees of voltages, in shares of the converter's range.

    `low, span`: lower end and width of the range, in volts; `steps`: ``2**bits``; 0 without a converter; `offset`:
    standard deviation of the offsets; `noise` (cells,): deviation of every measurement; `falling`: 1, or -1 where the
    goal rail lies above the other.
    """

    low: float
    span: float
    steps: float
    offset: float
    noise: NDArray[np.float64]
    falling: float

    @property
    def random(self) -> bool:
        """Whether two robots see different things on one chip."""
        return self.offset > 0 or bool(self.noise.any())


def eyes_of(readout: Readout, cell_map: CellMap, noise: NDArray[np.float64] | None) -> Eyes:
    """Bring a read-out to shares of its range; ``noise`` in volts, shape (cells,)."""
    rails = sorted((cell_map.wiring.goal_voltage, cell_map.wiring.goal_voltage + cell_map.wiring.supply))
    low, high = readout.range or (rails[0], rails[1])
    span = high - low
    deviation = np.zeros(cell_map.space.cell.size) if noise is None else noise / span
    steps = 0.0 if readout.bits is None else 2.0**readout.bits
    return Eyes(low, span, steps, (readout.offset or 0.0) / span, deviation, float(np.sign(cell_map.wiring.supply)))


def walk(volts: NDArray[np.float64], floor: Floor, eyes: Eyes, seed: Seed = 0) -> NDArray[np.bool_]:
    """Which cells a robot reaches the goal from.  Shapes: `volts` (nodes,); returns (cells,)."""
    from resgrid.chip import kernels

    cells, ways = floor.around.shape
    height = (volts[floor.node] - eyes.low) / eyes.span
    if eyes.offset:
        height += eyes.offset * generator(seed, OFFSET).standard_normal(cells)
    draw = np.empty((0, ways + 1))
    if eyes.noise.any():
        draw = generator(seed, NOISE).standard_normal((cells, ways + 1))
    following = np.empty(cells, dtype=np.int64)
    kernels.step_down(height, eyes.noise, draw, eyes.steps, eyes.falling, floor.around, following)
    return follow(following, floor)


def follow(following: NDArray[np.int64], floor: Floor) -> NDArray[np.bool_]:
    """Which cells lead to a goal when every cell leads to the one given, -1 for none; shape (cells,)."""
    from resgrid.chip import kernels

    reached = np.empty(len(following), dtype=np.bool_)
    kernels.follow(following, floor.goal, reached)
    return reached
