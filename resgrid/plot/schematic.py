"""Where the parts of a compiled netlist go on paper, in cells: pure geometry."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.netlist import CellMap, face_shape
from resgrid.space import Cell

HALF = 0.3
"""Half the side of the square that a rail cell is drawn as, in cells."""

MARGIN = 0.3
"""How far outside the grid the rail around it is drawn, in cells."""

Box = tuple[float, float, float, float]
"""Left, bottom, width, height."""


@dataclass(frozen=True, eq=False)
class Schematic:
    """Places of the parts of a netlist compiled from a space of one or two axes.

    `across, up`: cells along each side; `dot_node` (n,): nodes of free cells; `dot` (n, 2): where they are drawn;
    `start, end` (resistors, 2): ends of the resistors; `seam` (resistors,): resistors across a periodic seam: they
    are drawn outwards at the upper end; `obstacles, goals, open_cells`: squares of obstacle rails, goal rails, and
    cells without a node; `frame` (2, 2): sides of the grid that are part of the obstacle rail.
    """

    across: int
    up: int
    dot_node: NDArray[np.int32]
    dot: NDArray[np.float64]
    start: NDArray[np.float64]
    end: NDArray[np.float64]
    seam: NDArray[np.bool_]
    obstacles: tuple[Box, ...]
    goals: tuple[Box, ...]
    open_cells: tuple[Box, ...]
    frame: tuple[NDArray[np.float64], ...]


def schematic_of(cell_map: CellMap) -> Schematic:
    """Lay out a netlist that was compiled from a space of one or two axes."""
    cell = cell_map.space.cell if cell_map.space.ndim == 2 else cell_map.space.cell[:, np.newaxis]
    node = cell_map.node.reshape(cell.shape)
    dots = np.argwhere((cell == Cell.FREE) & (node >= 0))
    start, end, seam = _resistor_ends(cell_map, cell)
    edge = (*cell_map.wiring.edge, "open")[:2]
    railed = tuple(rule == "obstacle" and cell_map.obstacle_node >= 0 for rule in edge)
    merged = cell_map.wiring.rails == "merged"
    return Schematic(
        across=cell.shape[0],
        up=cell.shape[1],
        dot_node=node[tuple(dots.T)],
        dot=np.asarray(dots + 0.5, dtype=np.float64),
        start=start,
        end=end,
        seam=seam,
        obstacles=_boxes((cell == Cell.OBSTACLE) & (node >= 0), merged, railed),
        goals=_boxes((cell == Cell.GOAL) & (node >= 0), merged, (False, False)),
        open_cells=_boxes(node < 0, False, (False, False)),
        frame=_frame(cell.shape, railed),
    )


def _resistor_ends(
    cell_map: CellMap, cell: NDArray[np.uint8]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Ends on the lower and upper side of the face that each resistor crosses."""
    shape = cell_map.space.shape
    count = len(cell_map.resistor_face)
    ends = np.full((2, count, 2), 0.5)
    seam = np.zeros(count, dtype=np.bool_)
    first = 0
    for axis in range(len(shape)):
        faces = face_shape(shape, axis)
        mine = np.flatnonzero((cell_map.resistor_face >= first) & (cell_map.resistor_face < first + np.prod(faces)))
        index = np.array(np.unravel_index(cell_map.resistor_face[mine] - first, faces))
        first += int(np.prod(faces))
        for side, shift in enumerate((-1, 0)):
            place = index.copy()
            place[axis] += shift
            outside = (place[axis] < 0) | (place[axis] >= shape[axis])
            ends[side, mine, : len(shape)] = place.T + 0.5
            towards = 1.0 if side == 0 else -1.0
            inner = np.clip(place, 0, np.array(shape)[:, None] - 1)
            boxed = cell[(*inner, 0)[:2]] != Cell.FREE
            ends[side, mine, axis] += towards * np.where(outside, 0.5 - MARGIN, np.where(boxed, HALF, 0.0))
        if cell_map.wiring.edge[axis] == "periodic":
            wrapped = mine[index[axis] == 0]
            seam[wrapped] = True
            ends[0, wrapped, axis] = shape[axis] + MARGIN
            ends[1, wrapped, axis] = shape[axis] - 0.5 + _half_of(cell, index[:, index[axis] == 0], axis)
    return ends[0], ends[1], seam


def _half_of(cell: NDArray[np.uint8], index: NDArray[np.int64], axis: int) -> NDArray[np.float64]:
    """Distance from the centre of the last cell of a ring to where its symbol ends."""
    last = index.copy()
    last[axis] = cell.shape[axis] - 1
    return np.where(cell[(*last, 0)[:2]] != Cell.FREE, HALF, 0.0)


def _boxes(mask: NDArray[np.bool_], joined: bool, railed: tuple[bool, ...]) -> tuple[Box, ...]:
    """A square for each cell, and bridges between neighbours, and to the rail around, that are one node."""
    boxes: list[Box] = []
    for i, j in np.argwhere(mask).tolist():
        boxes.append((i + 0.5 - HALF, j + 0.5 - HALF, 2 * HALF, 2 * HALF))
        if not joined:
            continue
        right = i + 1 < mask.shape[0] and bool(mask[i + 1, j])
        above = j + 1 < mask.shape[1] and bool(mask[i, j + 1])
        if right:
            boxes.append((i + 0.5, j + 0.5 - HALF, 1.0, 2 * HALF))
        if above:
            boxes.append((i + 0.5 - HALF, j + 0.5, 2 * HALF, 1.0))
        if right and above and mask[i + 1, j + 1]:
            boxes.append((i + 0.5, j + 0.5, 1.0, 1.0))
        boxes.extend(_to_frame(i, j, mask.shape, railed))
    return tuple(boxes)


def _to_frame(i: int, j: int, shape: tuple[int, ...], railed: tuple[bool, ...]) -> list[Box]:
    reach = 0.5 + MARGIN
    bridges: list[Box] = []
    if railed[0] and i == 0:
        bridges.append((-MARGIN, j + 0.5 - HALF, reach, 2 * HALF))
    if railed[0] and i == shape[0] - 1:
        bridges.append((i + 0.5, j + 0.5 - HALF, reach, 2 * HALF))
    if railed[1] and j == 0:
        bridges.append((i + 0.5 - HALF, -MARGIN, 2 * HALF, reach))
    if railed[1] and j == shape[1] - 1:
        bridges.append((i + 0.5 - HALF, j + 0.5, 2 * HALF, reach))
    return bridges


def _frame(shape: tuple[int, ...], railed: tuple[bool, ...]) -> tuple[NDArray[np.float64], ...]:
    left, bottom = -MARGIN, -MARGIN
    right, top = shape[0] + MARGIN, shape[1] + MARGIN
    if not railed[1]:
        bottom, top = 0.2, shape[1] - 0.2
    if not railed[0]:
        left, right = 0.2, shape[0] - 0.2
    sides = []
    if railed[0]:
        sides += [[(left, bottom), (left, top)], [(right, bottom), (right, top)]]
    if railed[1]:
        sides += [[(left, bottom), (right, bottom)], [(left, top), (right, top)]]
    return tuple(np.array(side) for side in sides)
