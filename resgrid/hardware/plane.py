"""Computation of the copper plane of the high rail on the back: the board's area less clearances around other nets."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from shapely import LineString, Point as Disc, Polygon, box, union_all
from shapely.geometry.base import BaseGeometry

from resgrid.hardware.kicad.footprints import PlacedFootprint
from resgrid.hardware.kicad.pcb import Plane
from resgrid.hardware.placement import Placement, Point
from resgrid.hardware.routing import Routing

_CLEARANCE = 0.3
"""Clearance that the board file states for the copper plane, in millimetres: its distance from copper of other nets."""

_DISTANCE = 0.32
"""Distance from copper of other nets at which the polygons of the plane end, in millimetres.

It exceeds the stated clearance `_CLEARANCE`, because polygons replace arcs and lie up to 1 % inside them.
"""

_EDGE = 0.6
"""Distance between the copper plane and the edge of the board, in millimetres."""

_HOLE = 0.6
"""Distance between the copper plane and mounting holes, in millimetres."""

_GAP, _SPOKE = 0.45, 0.7
"""Width of the gap around a soldered pin of the plane's net, and width of the four spokes across it, in millimetres.

The gap keeps the heat of soldering in the pin (thermal relief).
"""

_THINNEST = 0.3
"""Smallest width of the plane's copper, in millimetres; thinner parts are removed."""

_STEPS = 8
"""Number of straight segments that replace a quarter of a circle."""


def fill_plane(placement: Placement, routing: Routing) -> Plane:
    """Return the copper plane of the high rail (the net of the positive supply) on the back of a board.

    Pieces of the copper that no via or pad of the high rail touches are left out.
    """
    net = placement.circuit.high_net
    (x0, y0), (x1, y1) = placement.origin, placement.corner
    outline = box(x0 + _EDGE, y0 + _EDGE, x1 - _EDGE, y1 - _EDGE).buffer(-2.5).buffer(2.5, quad_segs=_STEPS)
    cut, gaps, spokes, contacts = list[BaseGeometry](), list[BaseGeometry](), list[BaseGeometry](), list[Point]()
    for placed in placement.parts:
        _cut_part(placed, net, cut, gaps, spokes, contacts)
    for track in routing.tracks:
        if track.layer == "B.Cu" and track.net != net:
            cut.append(LineString([track.start, track.stop]).buffer(track.width / 2 + _DISTANCE, quad_segs=_STEPS))
    for via in routing.vias:
        if via.net == net:
            contacts.append((via.x, via.y))
        else:
            cut.append(Disc(via.x, via.y).buffer(via.size / 2 + _DISTANCE, quad_segs=_STEPS))
    foreign = union_all(cut)
    copper = outline.difference(union_all([foreign, *gaps]))
    copper = copper.buffer(-_THINNEST / 2).buffer(_THINNEST / 2, quad_segs=_STEPS)
    copper = copper.union(union_all(spokes).difference(foreign))
    pieces = [piece for piece in _polygons(copper) if any(piece.intersects(Disc(place)) for place in contacts)]
    corners = tuple((round(x, 4), round(y, 4)) for x, y in list(outline.exterior.coords)[:-1])
    return Plane(net, "B.Cu", corners, tuple(_without_holes(piece) for piece in pieces), clearance=_CLEARANCE)


def _cut_part(
    placed: PlacedFootprint, net: str, cut: list[BaseGeometry], gaps: list[BaseGeometry], spokes: list[BaseGeometry],
    contacts: list[Point],
) -> None:  # fmt: skip
    """Append the areas that the holes and pads of a part cut out of the plane, and the spokes to its soldered pins.

    `placed`: the part; `net`: net of the plane; `cut`: areas around pads of other nets and around holes; `gaps`: areas
    around soldered pins of the plane's net; `spokes`: connections across these gaps; `contacts`: places at which pads
    of the plane's net meet the plane. The last four are lists, which are extended.
    """
    soldered = "through_hole" in placed.footprint.attributes
    for number, pad in enumerate(placed.footprint.pads):
        if not pad.drill:
            continue
        x, y = placed.place_of(pad)
        radius = pad.width / 2
        if not pad.number:
            cut.append(Disc(x, y).buffer(radius + _HOLE, quad_segs=_STEPS))
            continue
        shape = (
            Disc(x, y).buffer(radius, quad_segs=_STEPS)
            if pad.shape == "circle"
            else box(x - radius, y - radius, x + radius, y + radius)
        )
        own = placed.nets[number] == net
        if not own:
            cut.append(shape.buffer(_DISTANCE, quad_segs=_STEPS))
        elif soldered:
            reach, half = radius + _GAP + 0.3, _SPOKE / 2
            gaps.append(shape.buffer(_GAP, quad_segs=_STEPS))
            spokes.append(
                box(x - reach, y - half, x + reach, y + half).union(box(x - half, y - reach, x + half, y + reach))
            )
        if own:
            contacts.append((x, y))


def _polygons(area: BaseGeometry) -> Iterator[Polygon]:
    """Yield the polygons of an area, sorted by their smallest x and then by their smallest y (y downwards)."""
    parts = [part for part in getattr(area, "geoms", [area]) if isinstance(part, Polygon) and not part.is_empty]
    yield from sorted(parts, key=lambda part: part.bounds)


def _without_holes(area: Polygon) -> tuple[Point, ...]:
    """Return one closed line around a polygon with holes, in which slits without width lead to the holes.

    From each hole's leftmost corner, a horizontal slit leads to the nearest edge on its left; KiCad's files have no
    holes.
    """
    line = _corners(area.exterior.coords)
    holes = [_corners(ring.coords) for ring in area.interiors]
    holes.sort(key=lambda hole: (hole[:, 0].min(), hole[:, 1].min()))
    for hole in holes:
        first = int(np.lexsort((hole[:, 1], hole[:, 0]))[0])
        line = _with_slit(line, np.roll(hole, -first, axis=0))
    return tuple((float(x), float(y)) for x, y in line)


def _corners(coordinates: Iterable[tuple[float, ...]]) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """Return the corners (n, 2) of a closed line, in millimetres, without the repeated first corner at the end."""
    return np.round(np.array(list(coordinates), dtype=np.float64)[:-1, :2], 4)


def _with_slit(
    line: np.ndarray[tuple[int, int], np.dtype[np.float64]], hole: np.ndarray[tuple[int, int], np.dtype[np.float64]]
) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """Return a closed line (n + m + 3, 2) that also goes around a hole, to which a slit without width leads.

    `line` (n, 2): corners of the closed line; `hole` (m, 2): corners of the hole, the leftmost one first.
    """
    x, y = hole[0]
    after = np.roll(line, -1, axis=0)
    low, high = np.minimum(line[:, 1], after[:, 1]), np.maximum(line[:, 1], after[:, 1])
    crossed = np.flatnonzero((low <= y) & (y <= high) & (low < high))
    ratio = (y - line[crossed, 1]) / (after[crossed, 1] - line[crossed, 1])
    meets = line[crossed, 0] + ratio * (after[crossed, 0] - line[crossed, 0])
    left = meets < x
    best = int(np.argmax(np.where(left, meets, -np.inf)))
    edge, gate = int(crossed[best]), np.round(np.array([[meets[best], y]]), 4)
    return np.concatenate([line[: edge + 1], gate, hole, hole[:1], gate, line[edge + 1 :]])
