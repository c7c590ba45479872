"""Drawn cells (GDSII) of which a layout's tiles are composed, one tile per cell of the grid, and their places.

A tile belongs to a cell of the grid.  Its origin is the centre of a vertical bar of metal 1, the node.  The resistor to
the next node along x starts at the bar, in row 0; the resistor to the next node along y starts at the bar above it, and
a strap leads from its other end back to the bar of the next tile.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from resgrid.hardware.layout_resistors import Head, Serpentine, draw_resistor
from resgrid.hardware.layout_rules import Box, CellPlacement, DrawnCell, LayoutRules, fill_vias


@dataclass(frozen=True)
class TileGeometry:
    """Measures of a tile, the drawing of one cell of the grid, in nanometres from its node.

    The node of a tile is a vertical bar of metal 1. The origin is the centre of the bar's width, at the height of the
    first row of the resistor to the next tile along x. `px`, `py`: distances between tiles along x and y; `start`: x at
    which the bodies of resistors begin; `upper`: y of the first row of the resistor along y; `back`: y of the centre of
    the wire of metal 1 from the resistor along y to the next tile; `wire`: width of such wires; `low`, `high`: y of the
    lower and upper end of the bar; `link`: width of a wire of metal 2 or 3 between goal cells; `stripe`: y of the lower
    and upper edge of the obstacle rail's wire of metal 2.
    """

    px: int
    py: int
    start: int
    upper: int
    back: int
    wire: int
    low: int
    high: int
    link: int
    stripe: tuple[int, int]


def tile_geometry(rules: LayoutRules, head: Head, shapes: Sequence[Serpentine]) -> TileGeometry:
    """Return the measures of the smallest tile that holds any two of the given resistors, one along each axis.

    A tile is the drawing of one cell of the grid. `head`: measures of the ends of resistors; `shapes`: all different
    resistors.
    """
    metal, second = rules.metals[0], rules.metals[1]
    half, over = shapes[0].width // 2, rules.overlap
    wire = rules.even(max(rules.contact_size + 2 * rules.contact_metal, metal.width))
    top = (max(shape.rows for shape in shapes) - 1) * head.pitch
    apart = max(  # of the bodies of two resistors, from the last row of one to the first row of the next
        2 * (half + over) + max(rules.cover_space, rules.space),
        head.height // 2 + half + over + rules.contact_distance,
        head.height + rules.space,
        wire // 2 + head.metal + metal.space,
    )
    upper = rules.up(top + apart)
    back = rules.up(upper + top + head.metal + metal.space + wire / 2)
    py = max(upper + rules.up(top + apart), back + rules.up(wire / 2 + head.metal + metal.space))
    pads = [lower.via_size + 2 * lower.via_enclosure for lower in rules.metals[:2]]
    link = rules.even(max(pads + [side for upper in rules.metals[1:3] for side in (upper.width, upper.area**0.5)]))
    py = max(py, link + 2 * second.space + max(second.width, metal.via_size + 2 * metal.via_enclosure))
    end = head.contact + max(shape.end for shape in shapes)
    left = max(head.length - head.contact, 0)
    px = max(
        end + head.length + rules.space + left,
        end + head.contact + wire // 2 + metal.space + head.bar // 2,
        end + rules.cover_space,
        2 * (link + max(second.space, rules.metals[2].space)),
    )
    low = back - rules.up(py) - wire // 2
    stripe = (rules.up(link / 2 + second.space), rules.up(py) - rules.up(link / 2 + second.space))
    return TileGeometry(
        rules.up(px), rules.up(py), head.contact, upper, back, wire, low, upper + head.metal, link, stripe
    )


def tile_cells(rules: LayoutRules, head: Head, tile: TileGeometry, shapes: Sequence[Serpentine]) -> list[DrawnCell]:
    """Return the GDSII cells that tiles consist of.

    They are single vias, the bar of metal 1 that is a node, the ties (vias) from a bar to the obstacle rail and to a
    goal, and three cells per different resistance: cell ``r3`` is a resistor, ``x3`` connects this resistor to the bar
    of a tile and to the next bar along x, and ``y3`` along y. `shapes`: the drawn resistor of each resistance.
    """
    first, second, third = rules.metals[:3]
    half, link = head.bar // 2, tile.link // 2
    vias = [
        DrawnCell(metal.via, ((metal.via_layer, 0, 0, metal.via_size, metal.via_size),))
        for metal in rules.metals
        if metal.via
    ]
    bar = DrawnCell("node", ((first.layer, -half, tile.low, half, tile.high),))
    rail = (-half, tile.stripe[0], half, min(tile.stripe[1], tile.high))
    obstacle = DrawnCell("tie_obstacle", (), (fill_vias(first, *rail, rules.grid),))
    square = (-link, -link, link, link)
    stack = (fill_vias(first, *square, rules.grid), fill_vias(second, *square, rules.grid))
    goal = DrawnCell("tie_goal", ((second.layer, *square), (third.layer, *square)), stack)
    cells = [*vias, bar, obstacle, goal]
    for number, shape in enumerate(shapes):
        name = f"r{number}"
        cells.append(DrawnCell(name, tuple(draw_resistor(rules, head, shape))))
        cells.append(DrawnCell(f"x{number}", *_along_x(rules, head, tile, shape, name)))
        cells.append(DrawnCell(f"y{number}", *_along_y(rules, head, tile, shape, name)))
    return cells


def _along_x(
    rules: LayoutRules, head: Head, tile: TileGeometry, shape: Serpentine, name: str
) -> tuple[tuple[Box, ...], tuple[CellPlacement, ...]]:
    """Return the wires of metal 1 and the placed resistor that connect the bar of a tile to the next bar along x.

    A bar is the vertical piece of metal 1 that is the node of a tile. `shape`: the resistor; `name`: name of its cell.
    """
    layer, half = rules.metals[0].layer, tile.wire // 2
    x, y = tile.start + shape.end + head.contact, (shape.rows - 1) * head.pitch
    boxes: list[Box] = [(layer, x - half, y - head.metal, x + half, y + head.metal)]
    boxes.append((layer, x + half, y - half, tile.px - head.bar // 2, y + half))
    return tuple(boxes), (CellPlacement(name, tile.start, 0),)


def _along_y(
    rules: LayoutRules, head: Head, tile: TileGeometry, shape: Serpentine, name: str
) -> tuple[tuple[Box, ...], tuple[CellPlacement, ...]]:
    """Return the wires of metal 1 and the placed resistor that connect the bar of a tile to the next bar along y.

    A bar is the vertical piece of metal 1 that is the node of a tile. `shape`: the resistor; `name`: name of its cell.
    """
    layer, half = rules.metals[0].layer, tile.wire // 2
    x, y = tile.start + shape.end + head.contact, tile.upper + (shape.rows - 1) * head.pitch
    boxes: list[Box] = [(layer, x - half, y - head.metal, x + half, tile.back + half)]
    boxes.append((layer, -head.bar // 2, tile.back - half, x - half, tile.back + half))
    return tuple(boxes), (CellPlacement(name, tile.start, tile.upper),)


def placements(cell: str, mask: NDArray[np.bool_], tile: TileGeometry, origin: tuple[int, int]) -> list[CellPlacement]:
    """Return placements that put a cell at all true places of a mask, merged into few regular arrays.

    `cell`: name of the cell; `mask` (columns, rows): tiles that contain the cell; `origin`: column and row of the first
    entry of the mask.
    """
    return [
        CellPlacement(cell, (origin[0] + i) * tile.px, (origin[1] + j) * tile.py, columns, rows, tile.px, tile.py)
        for i, j, columns, rows in rectangles(mask)
    ]


def rectangles(mask: NDArray[np.bool_]) -> Iterator[tuple[int, int, int, int]]:
    """Yield disjoint rectangles that cover exactly the true entries of a mask.

    A rectangle is (first column, first row, number of columns, number of rows). Runs of true entries along one axis are
    merged with equal runs in the next lines; the axis that gives fewer rectangles is chosen. `mask`: array (columns,
    rows).
    """
    along = _merged_runs(mask)
    across = _merged_runs(mask.T)
    if len(along) <= len(across):
        yield from along
    else:
        yield from ((i, j, columns, rows) for j, i, rows, columns in across)


def _merged_runs(mask: NDArray[np.bool_]) -> list[tuple[int, int, int, int]]:
    """Return rectangles of runs of true entries along the first axis, merged with equal runs along the second axis.

    A rectangle is (first index along axis 0, first index along axis 1, entries along axis 0, entries along axis 1).
    """
    found: list[tuple[int, int, int, int]] = []
    begun: Mapping[tuple[int, int], int] = {}
    for j in range(mask.shape[1] + 1):
        line = mask[:, j] if j < mask.shape[1] else np.zeros(mask.shape[0], dtype=bool)
        edges = np.flatnonzero(np.diff(np.concatenate(([False], line, [False])).astype(np.int8))).tolist()
        runs = set(zip(edges[::2], edges[1::2], strict=True))
        found += [(i, low, end - i, j - low) for (i, end), low in begun.items() if (i, end) not in runs]
        begun = {run: begun.get(run, j) for run in sorted(runs)}
    return sorted(found)
