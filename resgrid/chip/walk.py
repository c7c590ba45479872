"""Read-out and walk: the steps of a robot that knows voltages only from an analogue-to-digital converter.

In a cell, the robot measures the voltages of the cell and of its face neighbours, and steps to the lowest reading.  The
converter rounds every voltage down to one of ``2**bits`` equal steps of its range.  The robot moves only to a strictly
lower reading.  Among equal readings it takes the first: axes in their order, lower side first.  The robot is lost where
no neighbour has a lower reading, and where it returns to a cell that it has passed.  The offset of a cell's read-out is
constant; every measurement has its own noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.chip.adc_resolution import enterable
from resgrid.core.cell import Cell
from resgrid.core.cell_map import CellMap
from resgrid.core.random_sites import NOISE, OFFSET, Seed, generator
from resgrid.core.regions import cells_at_faces, slab, with_margin
from resgrid.scene.chip import Readout


@dataclass(frozen=True, eq=False)
class Neighbours:
    """Face neighbours of every cell, between which the robot moves, and the nodes and goal mask of the cells.

    `around` (cells, 2 ndim): flat indices (C order) of the free and goal neighbours of every free cell, -1 for none;
    axis by axis, lower side first; `goal` (cells,): mask of the goal cells; `node` (cells,): node of every cell, 0
    (ground) for cells without a node.
    """

    around: NDArray[np.int64]
    goal: NDArray[np.bool_]
    node: NDArray[np.int64]


def neighbours_of(cells: CellMap) -> Neighbours:
    """Return the face neighbours, goal mask and nodes of the cells of a netlist.

    `cells`: map of the cells of the netlist.
    """
    space = cells.space
    walkable = enterable(space) & (cells.node >= 0)
    flat = np.where(walkable, np.arange(space.cell.size).reshape(space.shape), -1)
    padded, around = with_margin(flat, space.periodic, beyond=-1), []
    for axis, count in enumerate(space.shape):
        below, above = cells_at_faces(padded, axis)
        around += [slab(below, axis, 0, count), slab(above, axis, 1, count + 1)]
    around = [np.where(space.cell == Cell.FREE, side, -1).ravel() for side in around]
    node = np.where(cells.node >= 0, cells.node, 0)
    return Neighbours(np.stack(around, axis=1), (space.cell == Cell.GOAL).ravel(), node.ravel())


@dataclass(frozen=True, eq=False)
class Converter:
    """Read-out of the node voltages, with errors as fractions of the converter's range.

    `low, span`: lower end and width of the range, in volts; `steps`: number of steps of the range, ``2**bits``, 0 for a
    read-out without quantization; `offset`: standard deviation of the constant offsets of the cells, as a fraction of
    the range; `noise` (cells,): standard deviation of one measurement, as a fraction of the range; `falling`: factor of
    the readings before the lowest is chosen: 1, or -1 if the goal rail lies above the obstacle rail.
    """

    low: float
    span: float
    steps: float
    offset: float
    noise: NDArray[np.float64]
    falling: float

    @property
    def random(self) -> bool:
        """Whether readings contain random errors (offset or noise)."""
        return self.offset > 0 or bool(self.noise.any())


def converter_of(readout: Readout, cells: CellMap, noise: NDArray[np.float64] | None = None) -> Converter:
    """Return the converter of a read-out.

    `readout`: description of the read-out; `cells`: map of the cells; without a range in `readout`, the range reaches
    from rail to rail of this circuit; `noise` (cells,): rms noise of one measurement in volts, None for 0.
    """
    wiring = cells.wiring
    low, high = readout.range or sorted((wiring.goal_voltage, wiring.high))
    deviation = np.zeros(cells.space.cell.size) if noise is None else noise / (high - low)
    steps = 0.0 if readout.bits is None else 2.0**readout.bits
    offset = (readout.offset or 0.0) / (high - low)
    return Converter(low, high - low, steps, offset, deviation, float(np.sign(wiring.supply)))


def reaches_goal(
    volts: NDArray[np.float64], neighbours: Neighbours, converter: Converter, seed: Seed = 0
) -> NDArray[np.bool_]:
    """Return the mask of the cells from which the robot reaches a goal, shape (cells,).

    `volts` (nodes,): node voltages; `neighbours`: face neighbours of every cell; `converter`: read-out; `seed`: seed of
    the chip, from which the offsets and the noise are drawn.
    """
    return walk(read_out(volts, neighbours, converter, seed), neighbours)


def read_out(volts: NDArray[np.float64], neighbours: Neighbours, converter: Converter, seed: Seed) -> NDArray[np.int64]:
    """Return for every cell the flat index of the face neighbour with the lowest reading, shape (cells,).

    The index is -1 where no neighbour reads lower than the cell, and for cells that are not free.  `volts` (nodes,):
    node voltages; `neighbours`: face neighbours of every cell; `converter`: read-out; `seed`: seed of the chip, from
    which the offsets and the noise are drawn.
    """
    from resgrid.chip.kernels import lowest_neighbours

    cells, sides = neighbours.around.shape
    height = (volts[neighbours.node] - converter.low) / converter.span
    if converter.offset:
        height += converter.offset * generator(seed, OFFSET).standard_normal(cells)
    draw = np.empty((0, sides + 1))
    if converter.noise.any():
        draw = generator(seed, NOISE).standard_normal((cells, sides + 1))
    following = np.empty(cells, dtype=np.int64)
    lowest_neighbours(height, converter.noise, draw, converter.steps, converter.falling, neighbours.around, following)
    return following


def walk(following: NDArray[np.int64], neighbours: Neighbours) -> NDArray[np.bool_]:
    """Return the mask of the cells from which a walk along `following` reaches a goal, shape (cells,).

    `following` (cells,): flat index of the next cell, -1 where the robot is stuck; `neighbours`: gives the goal cells.
    """
    from resgrid.chip.kernels import reach_goals

    reached = np.empty(len(following), dtype=np.bool_)
    reach_goals(following, neighbours.goal, reached)
    return reached
