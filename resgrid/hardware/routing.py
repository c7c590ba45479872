"""Computation of the tracks and vias of a board by fixed rules, without a search.

The front has the tracks of the grid, of goal regions, of the ring of the high rail, and of ground.  The back has the
tracks of the goal rails and of converter headers; its copper plane is computed elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from resgrid.core.cell import Cell
from resgrid.hardware.kicad.footprints import PlacedFootprint
from resgrid.hardware.kicad.pcb import Track, Via
from resgrid.hardware.placement import LANE, Placement, Point, rounded
from resgrid.hardware.record import GROUND

_RAIL, _THIN, _WIDE = 0.8, 0.2, 0.3
"""Widths of the tracks of rails, of tracks to converter headers, and of tracks from goal regions, in millimetres."""

_CLEARANCE = 0.2
"""Smallest distance between tracks on different nets, in millimetres."""

_BELOW = 1.65
"""Distance of the lower horizontal track of a goal region below the centre of its row of cells, in millimetres."""

_FIRST_LANE = 0.95
"""Distance of the innermost vertical track from the ring of the high rail, in millimetres.

The ring is the track around the grid on the net of the positive supply.
"""


@dataclass(frozen=True)
class Routing:
    """The tracks and vias of a board (`tracks`, `vias`), without pads and the copper plane."""

    tracks: tuple[Track, ...]
    vias: tuple[Via, ...]


def route(placement: Placement) -> Routing:
    """Return all tracks and vias of a board."""
    parts: list[Track | Via] = [
        *_grid(placement),
        *_ring(placement),
        *_goal_regions(placement),
        *_goal_tracks(placement),
        *_jumpers(placement),
        *_channels(placement),
        *_ground(placement),
    ]
    unique = dict.fromkeys(parts)
    tracks = tuple(part for part in unique if isinstance(part, Track) and part.start != part.stop)
    return Routing(tracks, tuple(part for part in unique if isinstance(part, Via)))


def _path(points: list[Point], net: str, layer: str, width: float) -> Iterator[Track]:
    """Yield the straight tracks between consecutive points.

    `points`: places (x, y) in mm; `net`: net of the tracks; `layer`: name of the copper layer; `width`: in mm.
    """
    corners = [rounded(*point) for point in points]
    yield from (Track(start, stop, net, layer, width) for start, stop in pairwise(corners))


def _grid(placement: Placement) -> Iterator[Track | Via]:
    """Yield the tracks from every resistor to the cells at its ends, and vias to the plane at cells without a test pad.

    These cells are obstacles. The copper plane on the back has the net of the positive supply.
    """
    circuit = placement.circuit
    columns, rows = placement.shape
    for part, placed in zip(circuit.resistors, placement.resistors, strict=True):
        for pad, net, cell in zip(placed.footprint.pads, placed.nets, part.ends, strict=True):
            stop = placement.at(*cell)
            yield Track(rounded(*placed.place_of(pad)), stop, net)
            inside = 0 <= cell[0] < columns and 0 <= cell[1] < rows
            if inside and cell not in circuit.cell_nets:
                yield Via(*stop, net)


def _ring(placement: Placement) -> Iterator[Track | Via]:
    """Yield the closed track of the high rail around the grid, with vias to the plane at both ends of rows and columns.

    The high rail is the net of the positive supply, to which the copper plane on the back belongs, too.
    """
    net, (x0, y0, x1, y1) = placement.circuit.high_net, placement.ring
    yield from _path([(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)], net, "F.Cu", _RAIL)
    columns, rows = placement.shape
    for i in range(columns):
        yield Via(*placement.at(i, -1), net)
        yield Via(*placement.at(i, rows), net)
    for j in range(rows):
        yield Via(*placement.at(-1, j), net)
        yield Via(*placement.at(columns, j), net)


def _goal_regions(placement: Placement) -> Iterator[Track]:
    """Yield the tracks between neighbouring cells of a goal region; none on a board with jumpers."""
    if placement.circuit.kind == "jumpers":
        return
    goal = placement.circuit.space.cell == Cell.GOAL
    for i, j in np.argwhere(goal).tolist():
        for other in ((i + 1, j), (i, j + 1)):
            if other in placement.circuit.cell_nets and goal[other]:
                net = placement.circuit.cell_nets[i, j]
                yield Track(placement.at(i, j), placement.at(*other), net, "F.Cu", _RAIL)


def _links(placement: Placement) -> dict[str, Point]:
    """Return the place (x, y) in mm of the pin of each goal link (header that ties a goal region to ground), by net."""
    found = {}
    for placed in placement.headers:
        if placed.value.startswith("LINK"):
            found[placed.nets[1]] = placed.place_of(placed.footprint.pads[1])
    return found


def _goal_tracks(placement: Placement) -> Iterator[Track]:
    """Yield the tracks of goal regions on the back.

    Each track begins at one chosen cell of its region, and runs below the row of this cell to the right. Outside the
    ring of the high rail it runs down, to the header that ties the region to ground. A board with jumpers has no such
    tracks.
    """
    _, _, right, bottom = placement.ring
    links = _links(placement)
    for number, tap in enumerate(placement.goal_taps):
        (x, y), (link_x, link_y) = placement.at(*tap.cell), links[tap.net]
        height = y + _BELOW - (_WIDE + _CLEARANCE) * tap.lane
        lane = _FIRST_LANE + LANE * number
        corners = [(x, y), (x, height), (right + lane, height), (right + lane, bottom + lane), (link_x, bottom + lane)]
        yield from _path([*corners, (link_x, link_y)], tap.net, "B.Cu", _WIDE)


def _jumpers(placement: Placement) -> Iterator[Track | Via]:
    """Yield the tracks from every solder jumper to its cell's node, the copper plane and the goal rail, with the rail.

    The goal rail has one horizontal track per row of cells on the back, and a vertical track that joins them and leads
    to the header that ties the rail to ground. A board of kind "fixed" has no solder jumpers, so that nothing is
    yielded.
    """
    circuit = placement.circuit
    if circuit.kind == "fixed":
        return
    half, net = placement.pitch / 2, circuit.goal_nets[0]
    rows = placement.shape[1]
    for placed in placement.jumpers:
        first, middle, last = (placed.place_of(pad) for pad in placed.footprint.pads)
        x, y = placed.x - half, placed.y + half
        node = [(x, y), (x + 1.35, y - 1.35), (x + 1.35, middle[1] + 0.5), (x + 1.85, middle[1]), middle]
        yield from _path(node, placed.nets[1], "F.Cu", 0.25)
        via = rounded(placed.x + 1.35, first[1])
        yield from _path([first, via], placed.nets[0], "F.Cu", _WIDE)
        yield Via(*via, placed.nets[0])
        rail = rounded(placed.x + 1.35, y - half - 1.775)
        yield from _path([last, (rail[0] - abs(rail[1] - last[1]), last[1]), rail], net, "F.Cu", _WIDE)
        yield Via(*rail, net)
    _, _, right, bottom = placement.ring
    (link_x, link_y), lane = _links(placement)[net], _FIRST_LANE + 0.3
    for j in range(rows):
        x, y = placement.at(0.5, j)
        height = y - half - 1.775
        yield from _path([(x + 1.35, height), (right + lane, height)], net, "B.Cu", 0.6)
    corners = [(right + lane, placement.at(0, rows - 1)[1] - half - 1.775), (right + lane, bottom + lane)]
    yield from _path([*corners, (link_x, bottom + lane), (link_x, link_y)], net, "B.Cu", _RAIL)


def _channels(placement: Placement) -> Iterator[Track | Via]:
    """Yield the tracks on the back from cells to the header rows of a converter.

    The horizontal tracks of a row lie above the cells of the row. The leftmost cell has the lowest track, so that no
    tracks cross.
    """
    left = placement.ring[0]
    for group in placement.channels:
        count = len(group)
        for position, channel in enumerate(group):
            x, y = placement.at(*channel.cell)
            pin_x, pin_y = channel.pin
            height = y - placement.lane(count - 1 - position)
            up = pin_y < height
            lane = left - _FIRST_LANE - LANE * (position if up else count - 1 - position)
            if placement.circuit.kind == "jumpers":
                # The track of the solder jumper passes here; a track from the pad would cut the plane into pieces.
                x, y = x + 1.35, y - 2.1
                yield Via(*rounded(x, y), channel.net)
            corners = [(x, y), (x, height), (lane, height), (lane, pin_y), (pin_x, pin_y)]
            yield from _path(corners, channel.net, "B.Cu", _THIN)


def _ground(placement: Placement) -> Iterator[Track]:
    """Yield the tracks of ground on the front: a line below the terminals, and a track to every ground pin."""
    line = placement.ring[3] + 10.6
    pins: list[Point] = []
    for placed in placement.headers:
        pins += [_place(placed, at) for at, net in enumerate(placed.nets) if net == GROUND]
    for x, y in pins:
        yield from _path([(x, y), (x, line)], GROUND, "F.Cu", _RAIL)
    across = sorted(x for x, _ in pins)
    yield from _path([(x, line) for x in across], GROUND, "F.Cu", _RAIL)


def _place(placed: PlacedFootprint, at: int) -> Point:
    """Return the place (x, y) in mm of a pad of a part; `at`: index of the pad, from 0."""
    return placed.place_of(placed.footprint.pads[at])
