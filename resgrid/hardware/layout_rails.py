"""Plan and drawing of the rails and pads of a layout: obstacle rail, trunks of goals and of the start, bond pads.

Metal 2 runs along x: one stripe of the obstacle rail per row of tiles, links between goal cells, and a track per trunk
below the array.  Metal 3 runs along y: links between goal cells, and the trunk of every goal region and of the start to
its track.  Metal 1 leads from the tracks to the pads, which are in one row below the array.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from resgrid.errors import InputError
from resgrid.hardware.layout_array import ORIGIN, TileArray, first_cells, used_range
from resgrid.hardware.layout_rules import Box, CellPlacement, DrawnCell, Label, LayoutRules, MetalRules, fill_vias
from resgrid.hardware.layout_tiles import TileGeometry, placements

STRIP = 5000
"""Height of the rectangle of vias at the upper edge of a pad, across the edge (y), in nanometres."""

VIA_STRIP = 20000
"""Largest width of the rectangle of vias at the upper edge of a pad, along the edge (x), in nanometres."""

DROP = 0.001
"""Largest voltage drop along a trunk, as a fraction of the supply, for which the width of trunks is chosen.

A trunk is the vertical wire of a goal region or of the start.
"""

WIDEST = 10_000
"""Largest width of a trunk that is chosen for its voltage drop, in nanometres.

Wider metal would need a larger spacing. A current density limit may still demand a wider trunk.
"""

RING = 5000
"""Smallest width of the vertical parts of the obstacle rail at both sides of the array, in nanometres."""


@dataclass(frozen=True)
class Trunk:
    """A vertical wire of metal 3 from a tile of a goal region or the start down to a horizontal wire below the array.

    A tile is the drawing of one cell of the grid. `net`: name of the net; `column`, `row`: the tile at which the trunk
    begins; `x`: centre of the trunk, from the node of cell (0, 0); `width`: width of the trunk; lengths are in
    nanometres.
    """

    net: str
    column: int
    row: int
    x: int
    width: int


@dataclass(frozen=True)
class PlacedPad:
    """A bond pad; `net`: name of its net; `x`, `y`: its centre, in nanometres from the node of cell (0, 0)."""

    net: str
    x: int
    y: int


@dataclass
class TopCell:
    """Contents of the top cell of a layout, extended while the rails are drawn.

    `boxes`: rectangles; `placements`: placed cells; `labels`: texts; `cells`: definitions of the placed cells.
    """

    boxes: list[Box] = field(default_factory=list)
    placements: list[CellPlacement] = field(default_factory=list)
    labels: list[Label] = field(default_factory=list)
    cells: list[DrawnCell] = field(default_factory=list)

    def box(self, metal: MetalRules, x0: int, y0: int, x1: int, y1: int) -> None:
        """Add a rectangle of a metal; `x0`, `y0`, `x1`, `y1`: two opposite corners, in nanometres, in any order."""
        self.boxes.append((metal.layer, min(x0, x1), min(y0, y1), max(x0, x1), max(y0, y1)))


@dataclass(frozen=True)
class RailPlan:
    """Measures of rails and pads, in nanometres; x and y count from the node of cell (0, 0), y upwards.

    Cell (0, 0) is the lower left cell of the grid. `trunks`: vertical wires to goal regions and the start, from left to
    right; `pads`: the pads from left to right; `wire`: width of the horizontal wires (tracks) below the array, the
    larger one of the width of the trunks and the width that current density limits demand for the largest current of a
    trunk; `ring`: width of the two vertical parts of the obstacle rail, 0 without this rail; `sides`: x of the centres
    of the left and the right part; `bottom`: y of the lower end of the array; `tracks`: y of the centre of the track of
    each trunk, in the order of `trunks`; `bend`: y of the centre of the wires that lead from the obstacle rail outwards
    to its pads; `pad_top`: y of the upper edge of the pads; `rows`: indices of the grid's rows with a stripe of the
    obstacle rail.
    """

    trunks: tuple[Trunk, ...]
    pads: tuple[PlacedPad, ...]
    wire: int
    ring: int
    sides: tuple[int, int]
    bottom: int
    tracks: tuple[int, ...]
    bend: int
    pad_top: int
    rows: tuple[int, ...]


def pad_name(net: str, number: int) -> str:
    """Return the reference of a pad of a net: ``P_goal_0``, or ``P_obstacle_2`` for the second pad of its net.

    `number`: number among the pads of the net, from 1 on the left.
    """
    return f"P_{net}" if number == 1 else f"P_{net}_{number}"


def wire_width(rules: LayoutRules, metals: tuple[MetalRules, ...], amps: float, least: int) -> int:
    """Return the smallest width in nanometres at which a wire on each of the given metals may carry a current.

    `metals`: rules of the metals, with their current density limits (no limit if None); `amps`: current in amperes;
    `least`: lower limit of the width, in nanometres. The width is rounded up to twice the manufacturing grid.
    """
    widths = [amps / metal.current * 1e9 for metal in metals if metal.current]
    return rules.even(max([least, *widths]))


def plan_rails(
    rules: LayoutRules, array: TileArray, tile: TileGeometry, amps: Mapping[str, float], supply: float
) -> RailPlan:
    """Return the measures of rails and pads.

    `array`: contents of the tiles (drawings of one cell each); `tile`: measures of a tile; `amps`: current of every
    net, in amperes, of either sign; `supply`: magnitude of the voltage between the rails, in volts. The trunks are wide
    enough for a voltage drop of 0.1 % of the supply, unless another limit makes them narrower.
    """
    metals = rules.metals
    second, third = metals[1:3]
    columns, rows = (used_range(array.node, axis) for axis in range(2))
    largest = max((abs(amps[net]) for net in array.nets), default=0.0)
    wire = wire_width(rules, metals[:3], largest, tile.link)
    span = (rows[1] - rows[0] + 1) * tile.py
    widest = max(wire, min(rules.even(largest * third.sheet * span / (DROP * supply)), WIDEST))
    trunks = _fitting_trunks(rules, array, tile, widest)
    wire = max(wire, trunks[0].width if trunks else 0)
    has_ring = bool(array.obstacle.any())
    ring = wire_width(rules, (second,), abs(amps.get("obstacle", 0.0)) / 2, RING) if has_ring else 0
    gap = rules.even(2 * max(metal.space for metal in metals[:3]) + tile.link)
    sides = (columns[0] * tile.px - gap - ring // 2, (columns[1] + 1) * tile.px + gap + ring // 2)
    bottom = rows[0] * tile.py + tile.low - gap
    bend = bottom - ring // 2
    pitch = wire + max(metal.space for metal in metals[:3])
    begin = bottom - ring - gap - wire // 2
    tracks = tuple(begin - number * pitch for number in range(len(trunks)))
    pad_top = (tracks[-1] if tracks else begin) - wire // 2 - gap
    step = rules.pad + rules.pad_space
    centre = rules.up((sides[0] + sides[1]) / 2)
    first = centre - rules.up((len(trunks) - 1) * step / 2)
    pads = [
        PlacedPad(trunk.net, first + number * step, pad_top - rules.pad // 2) for number, trunk in enumerate(trunks)
    ]
    if has_ring:
        left, right = min(sides[0], first - step), max(sides[1], first + len(trunks) * step)
        pads = [PlacedPad("obstacle", left, pad_top - rules.pad // 2), *pads]
        pads.append(PlacedPad("obstacle", right, pad_top - rules.pad // 2))
    striped = tuple(int(j) + ORIGIN[1] for j in np.flatnonzero(array.obstacle.any(axis=0)))
    return RailPlan(trunks, tuple(pads), wire, ring, sides, bottom, tracks, bend, pad_top, striped)


def _fitting_trunks(rules: LayoutRules, array: TileArray, tile: TileGeometry, widest: int) -> tuple[Trunk, ...]:
    """Return the trunks of all nets, of one width for which each of them has a free track (x of a vertical wire).

    The width is halved until the trunks fit, at most down to the width of links between goal cells. `widest`: upper
    limit of the width, in nanometres. Raises InputError if not even the smallest width fits.
    """
    width = min(widest, rules.even(tile.px - tile.link - 2 * rules.metals[2].space - 2 * rules.grid))
    while width > tile.link:
        try:
            return _trunks(rules, array, tile, width)
        except InputError:
            width = max(tile.link, rules.even(width // 2))
    return _trunks(rules, array, tile, tile.link)


def _trunks(rules: LayoutRules, array: TileArray, tile: TileGeometry, width: int) -> tuple[Trunk, ...]:
    """Return one trunk per net, from left to right, on vertical tracks of metal 3 that no other net uses.

    Each column of tiles has as many tracks as wires of the width fit next to each other. `width`: width of the trunks
    in nanometres. Raises InputError if a net has no free track.
    """
    space, second = rules.metals[2].space, rules.metals[1]
    pitch = width + space
    least = rules.up((max(tile.link, width) + width) / 2 + space)
    last = tile.px - rules.up((max(tile.link, width) + width) / 2 + max(space, second.space))
    tracks = [0, *range(least, last + 1, pitch)]
    used: dict[int, set[int]] = {}
    trunks = []
    for number, net in enumerate(array.nets):
        best: tuple[int, int, int, int] | None = None
        for column, row in first_cells(array, number):
            taken = used.get(column, set())
            below = array.region[column - ORIGIN[0], : row - ORIGIN[1]]
            above = {0} if np.any((below >= 0) & (below != number)) else set()
            free = [track for track in range(len(tracks)) if track not in taken | above]
            if free and (best is None or (len(taken), free[0]) < best[:2]):
                best = (len(taken), free[0], column, row)
        if best is None:
            raise InputError(
                f"the trunk of {net} has no free track: its columns already hold {len(tracks)} trunks each; move or "
                "join goal regions, or give the resistors a larger width"
            )
        _, track, column, row = best
        used.setdefault(column, set()).add(track)
        trunks.append(Trunk(net, column, row, column * tile.px + tracks[track], width))
    return tuple(sorted(trunks, key=lambda trunk: (trunk.x, trunk.net)))


def draw_rails(rules: LayoutRules, array: TileArray, tile: TileGeometry, plan: RailPlan) -> TopCell:
    """Return the drawing of rails and pads: rectangles, placements of cells, labels, and definitions of the cells.

    `array`: contents of the tiles (drawings of one cell each); `tile`: measures of a tile; `plan`: measures of rails
    and pads.
    """
    drawing = TopCell()
    if plan.ring:
        _draw_obstacle_rail(rules, array, tile, plan, drawing)
    _draw_links(rules, array, tile, drawing)
    signals = [pad for pad in plan.pads if pad.net != "obstacle"]
    for trunk, pad, y in zip(plan.trunks, signals, plan.tracks, strict=True):
        _draw_trunk(rules, tile, plan, trunk, (pad.x, y), drawing)
    drawing.cells.append(_pad_cell(rules))
    for pad in plan.pads:
        drawing.placements.append(CellPlacement("pad", pad.x, pad.y))
        drawing.labels.append(Label(pad.net, pad.x, pad.y, rules.metals[-1].text))
    return drawing


def _draw_obstacle_rail(
    rules: LayoutRules, array: TileArray, tile: TileGeometry, plan: RailPlan, drawing: TopCell
) -> None:
    """Add the obstacle rail to `drawing`: its stripes, its vertical parts at both sides, and the wires to its pads."""
    metal, half = rules.metals[1], plan.ring // 2
    left, right = plan.sides
    low, high = tile.stripe
    drawing.cells.append(DrawnCell("stripe", ((metal.layer, left, low, right, high),)))
    striped = np.zeros((1, array.node.shape[1]), dtype=bool)
    striped[0, np.array(plan.rows) - ORIGIN[1]] = True
    drawing.placements += placements("stripe", striped, tile, (0, ORIGIN[1]))
    for x, pad in ((left, plan.pads[0].x), (right, plan.pads[-1].x)):
        drawing.box(metal, x - half, plan.bend - half, x + half, plan.rows[-1] * tile.py + high)
        drawing.box(metal, min(x, pad) - half, plan.bend - half, max(x, pad) + half, plan.bend + half)
        drawing.box(metal, pad - half, plan.pad_top - STRIP, pad + half, plan.bend + half)


def _draw_links(rules: LayoutRules, array: TileArray, tile: TileGeometry, drawing: TopCell) -> None:
    """Add the wires between neighbouring cells of each goal region to `drawing`: metal 2 along x, metal 3 along y."""
    half, region = tile.link // 2, array.region
    for name, axis, metal in (("link_x", 0, rules.metals[1]), ("link_y", 1, rules.metals[2])):
        joined = np.zeros(region.shape, dtype=bool)
        lower, upper = (region[:-1], region[1:]) if axis == 0 else (region[:, :-1], region[:, 1:])
        place = (slice(None, -1), slice(None)) if axis == 0 else (slice(None), slice(None, -1))
        joined[place] = (lower >= 0) & (lower == upper)
        if joined.any():
            end = (tile.px + half, half) if axis == 0 else (half, tile.py + half)
            drawing.cells.append(DrawnCell(name, ((metal.layer, -half, -half, *end),)))
            drawing.placements += placements(name, joined, tile, ORIGIN)


def _draw_trunk(
    rules: LayoutRules, tile: TileGeometry, plan: RailPlan, trunk: Trunk, end: tuple[int, int], drawing: TopCell
) -> None:
    """Add a trunk, its horizontal wire of metal 2, and the wire of metal 1 to the pad to `drawing`.

    `tile`: measures of a tile; `plan`: measures of rails and pads; `end`: x of the pad and y of the horizontal wire, in
    nanometres from the node of cell (0, 0).
    """
    first, second, third = rules.metals[:3]
    half, link, wide = trunk.width // 2, tile.link // 2, plan.wire // 2
    tile_x, tile_y = trunk.column * tile.px, trunk.row * tile.py
    pad_x, y = end
    if trunk.x != tile_x:
        drawing.box(second, tile_x - link, tile_y - link, trunk.x + half, tile_y + link)
        drawing.placements.append(
            fill_vias(second, trunk.x - half, tile_y - link, trunk.x + half, tile_y + link, rules.grid)
        )
    drawing.box(third, trunk.x - half, y - wide, trunk.x + half, tile_y + link)
    drawing.placements.append(fill_vias(second, trunk.x - half, y - wide, trunk.x + half, y + wide, rules.grid))
    drawing.box(second, min(trunk.x - half, pad_x - wide), y - wide, max(trunk.x + half, pad_x + wide), y + wide)
    drawing.placements.append(fill_vias(first, pad_x - wide, y - wide, pad_x + wide, y + wide, rules.grid))
    drawing.box(first, pad_x - wide, plan.pad_top - STRIP, pad_x + wide, y + wide)


def _pad_cell(rules: LayoutRules) -> DrawnCell:
    """Return the cell of a bond pad.

    It contains the highest metal with an opening of the passivation, and a rectangle of all metals and vias at its
    upper edge.
    """
    half, opening = rules.pad // 2, rules.pad // 2 - rules.pad_opening
    strip = (-min(half, VIA_STRIP // 2), half - STRIP, min(half, VIA_STRIP // 2), half)
    boxes: list[Box] = [(metal.layer, *strip) for metal in rules.metals[:-1]]
    boxes.append((rules.metals[-1].layer, -half, -half, half, half))
    boxes += [(layer, -half, -half, half, half) for layer in rules.pad_layers]
    if rules.passivation is not None:
        boxes.append((rules.passivation, -opening, -opening, opening, min(opening, half - STRIP)))
    return DrawnCell("pad", tuple(boxes), tuple(fill_vias(metal, *strip, rules.grid) for metal in rules.metals[:-1]))
