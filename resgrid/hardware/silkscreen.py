"""Printed texts and lines of a board: the scene's picture, labels of pads and terminals, title, and voltages."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from math import cos, pi, sin
from textwrap import wrap

import numpy as np
from shapely import LineString, MultiLineString, Point, box, union_all
from shapely.geometry.base import BaseGeometry

from resgrid.core.cell import Cell
from resgrid.hardware.kicad.footprints import Graphics, Text
from resgrid.hardware.placement import Index, Placement, label_size, rounded

_LINE = 0.15
"""Width of printed lines, in millimetres."""

_HATCH = 1.1
"""Distance of the parallel lines that fill obstacles, in millimetres."""

_FREE_OF_PADS, _FREE_OF_TEXT = 0.25, 0.2
"""Smallest distances of printed lines from pads and from texts, in millimetres."""

_INSET, _OVERLAP = 0.3, 0.02
"""Distance of the printed outline of obstacles from the border of their cells, in millimetres, and an overlap.

Cells are widened by the overlap, in millimetres, before neighbours are joined, so that their union has no gaps.
"""

SEE_BACK = "voltages: see back"
"""Line of the legend that is printed on the front only."""

_LEGEND = 5
"""Largest number of lines of the legend on the front; a longer legend is printed on the back only."""

_SHORTEST = 0.35
"""Largest length of a piece of a line between texts and pads that is not printed, in millimetres."""

Legend = tuple[str, str, tuple[str, ...]]
"""Texts of a board: title, second line, and lines of the legend of voltages."""


def draw_silkscreen(placement: Placement, legend: Legend, starts: Iterable[Index]) -> Graphics:
    """Return the texts and lines printed on the front and the back.

    `legend`: title, second line and lines of the legend; `starts`: cells (column, row) of the scene's starts.
    """
    texts = [
        *_title(placement, legend),
        *_numbers(placement),
        *_cell_labels(placement, set(starts)),
        *_terminal_labels(placement),
        *_front_legend(placement, legend[2]),
        *_back(placement, legend),
    ]
    blocked = _blocked(placement, [text for text in texts if text.layer == "F.SilkS"])
    drawing = MultiLineString(list(_lines(placement))).difference(blocked)
    pieces = sorted(
        tuple(round(value, 3) for point in piece.coords for value in point)
        for piece in getattr(drawing, "geoms", [drawing])
        if isinstance(piece, LineString) and piece.length > _SHORTEST
    )
    lines = [(*piece[k : k + 4], _LINE, "F.SilkS") for piece in pieces for k in range(0, len(piece) - 2, 2)]
    return Graphics(lines, texts)  # type: ignore[arg-type]


def _title(placement: Placement, legend: Legend) -> Iterator[Text]:
    """Yield title and second line of the front, shortened to the width between the mounting holes."""
    (x0, y0), (x1, _) = placement.origin, placement.corner
    width = x1 - x0 - 16.5
    size = max(1.0, min(1.6, width / (0.95 * max(1, len(legend[0])))))
    yield _fitted(legend[0], x0 + 8.2, y0 + 2.9, width, size)
    yield _fitted(legend[1], x0 + 8.2, y0 + 5.4, width, 0.9)


def _fitted(text: str, x: float, y: float, width: float, size: float) -> Text:
    """Return a text on the front, shortened to a width.

    `x`, `y`: place of its left end; `width`: largest width; `size`: height and width of its letters; all in
    millimetres.
    """
    most = max(1, int(width / (0.95 * size)))
    shown = text if len(text) <= most else text[: most - 3].rstrip() + "..."
    return Text(shown, *rounded(x, y), (size, size), align="left", thickness=round(max(0.12, size * 0.14), 3))


def _numbers(placement: Placement) -> Iterator[Text]:
    """Yield the numbers of columns, above and below the grid, and of rows, to its left and right."""
    x0, y0, x1, y1 = placement.ring
    columns, rows = placement.shape
    for i in range(columns):
        x = placement.at(i, 0)[0]
        yield Text(str(i), *rounded(x, y0 - 1.25), (0.9, 0.9))
        yield Text(str(i), *rounded(x, y1 + 1.25), (0.9, 0.9))
    for j in range(rows):
        y = placement.at(0, j)[1]
        yield Text(str(j), *rounded(x0 - 0.75, y), (0.9, 0.9), align="right")
        yield Text(str(j), *rounded(x1 + 0.85, y), (0.9, 0.9), align="left")


def _cell_labels(placement: Placement, starts: set[Index]) -> Iterator[Text]:
    """Yield the labels of cells: column and row, and the words GOAL and START on a board of kind "fixed".

    A board with jumpers has "O" (obstacle) and "G" (goal) at the outer pads of the solder jumpers instead of these
    words. `starts`: cells (column, row) of the scene's starts.
    """
    circuit = placement.circuit
    regions = circuit.space.goal_region
    for cell in circuit.cell_nets:
        x, y = placement.at(*cell)
        words = "{},{}".format(*cell)
        size = (0.6 if len(words) > 4 else 0.7, 0.8)
        if circuit.kind == "jumpers":
            yield Text(words, *rounded(x - 0.75, y + 1.08), size, align="right")
            x, y = placement.at(cell[0] + 0.5, cell[1] + 0.5)
            yield Text("O", *rounded(x + 2.2, y + 1.1))
            yield Text("G", *rounded(x + 2.2, y - 1.1))
            continue
        yield Text(words, *rounded(x + 1.6, y - 2.4), size, align="left")
        name = f"GOAL{regions[cell]}" if circuit.space.cell[cell] == Cell.GOAL else "START" if cell in starts else ""
        if name:
            yield Text(name, *rounded(x + 1.6, y + 1.45), (0.6, 0.8), align="left", thickness=0.15)


def _terminal_labels(placement: Placement) -> Iterator[Text]:
    """Yield the labels of the pins of supply, reference header, goal links and converter headers.

    The reference header offers supply, ground and ground on three pins, for measurements. A goal link is a two-pin
    header that ties a goal region to ground.
    """
    wiring = placement.circuit.wiring
    high = f"{wiring.supply:+g}V"
    for placed in placement.headers:
        x, y = placed.x, placed.y
        if placed.value == "SUPPLY":
            yield Text(high, *rounded(x - 2.54, y + 5.3), (1.0, 1.0), thickness=0.15)
            yield Text("GND", *rounded(x + 2.54, y + 5.3), (1.0, 1.0), thickness=0.15)
        elif placed.value == "REFERENCE":
            for pin, words in enumerate((high, "GND", "GND")):
                yield Text(words, *rounded(x + 1.6, y + 2.54 * pin), align="left")
        elif placed.value.startswith("LINK"):
            words = placed.nets[1].upper().replace("_", "")
            yield Text(words, *rounded(x, y + 1.95), (0.6, 0.8))
        else:
            for pin, net in enumerate(placed.nets):
                words = net.removeprefix("n_").replace("_", ",")
                size = label_size(len(words))
                yield Text(words, *rounded(x - 1.6, y + 2.54 * pin), size, align="right")


def _front_legend(placement: Placement, lines: Iterable[str]) -> Iterator[Text]:
    """Yield the legend between the reference header and the goal links; nothing if it would have more than five lines.

    The reference header offers supply, ground and ground on three pins, for measurements. Goal links are two-pin
    headers that tie goal regions to ground. `lines`: lines of the legend, which are divided at spaces to fit between
    the headers.
    """
    left, _, right, bottom = placement.ring
    links = [placed.x for placed in placement.headers if placed.value.startswith("LINK")]
    start = left + 18.2
    wrapped = _wrapped(lines, int((min([*links, right]) - 2.5 - start) / (0.95 * 0.8)))
    if len(wrapped) <= _LEGEND:
        for number, line in enumerate(wrapped):
            yield Text(line, *rounded(start, bottom + 3.6 + 1.45 * number), align="left")


def _back(placement: Placement, legend: Legend) -> Iterator[Text]:
    """Yield the printed texts of the back: title, at most three lines of the legend, and expected voltages below pads.

    A board of kind "jumpers" has no expected voltages, because it serves every scene of its size. `legend`: title,
    second line, and lines of the legend.
    """
    (x0, y0), (x1, y1) = placement.origin, placement.corner
    title = _fitted(legend[0], 0.0, y0 + 2.9, x1 - x0 - 16.5, 1.2)
    right = x1 - 8.2
    yield Text(title.text, right, title.y, title.size, layer="B.SilkS", align="left", thickness=title.thickness)
    most = int((x1 - x0 - 16.5) / (0.95 * 0.8))
    lines = [line for line in legend[2] if line != SEE_BACK]
    if placement.circuit.kind == "fixed":
        lines.append("numbers: expected voltages in V")
    for number, line in enumerate(_wrapped(lines, most)[:3]):
        yield Text(line, right, round(y1 - 4.3 + 1.45 * number, 4), layer="B.SilkS", align="left")
    if placement.circuit.kind == "jumpers":
        return
    circuit = placement.circuit
    for cell, net in circuit.cell_nets.items():
        x, y = placement.at(*cell)
        yield Text(f"{circuit.voltages[net]:.3f}", *rounded(x, y + 1.45), (0.7, 0.8), layer="B.SilkS")


def _wrapped(lines: Iterable[str], most: int) -> list[str]:
    """Return the given lines, divided at spaces into lines of at most `most` characters; a limit below 12 counts as 12.

    A word that is longer than the limit is divided, too.
    """
    return [part for line in lines for part in wrap(line, max(most, 12))]


def _blocked(placement: Placement, texts: list[Text]) -> BaseGeometry:
    """Return the area, in mm, that printed lines must avoid: pads, texts, references, and outlines of parts."""
    areas: list[BaseGeometry] = [box(*text.box).buffer(_FREE_OF_TEXT) for text in texts]
    for placed in placement.parts:
        for pad in placed.footprint.pads:
            (x, y), (width, height) = placed.place_of(pad), placed.size_of(pad)
            shape: BaseGeometry = box(x - width / 2, y - height / 2, x + width / 2, y + height / 2)
            shape = Point(x, y).buffer(width / 2) if pad.shape == "circle" else shape
            areas.append(shape.buffer(_FREE_OF_PADS))
        if placed.label is not None:
            text = Text(placed.reference, *placed.label, placed.label_size, placed.label_turn)
            areas.append(box(*text.box).buffer(_FREE_OF_TEXT))
    return union_all(areas)


def _lines(placement: Placement) -> Iterator[LineString]:
    """Yield the lines of the scene's picture, also lines across texts and pads, which are removed later.

    They are the border, hatched obstacles, and two circles around each goal cell.
    """
    yield from _border(placement)
    if placement.circuit.kind == "jumpers":
        return
    cell = placement.circuit.space.cell
    yield from _hatched(_area(placement, [(int(i), int(j)) for i, j in np.argwhere(cell == Cell.OBSTACLE)]))
    for at in np.argwhere(cell == Cell.GOAL).tolist():
        x, y = placement.at(*at)
        for radius in (1.15, 1.5):
            points = [(x + radius * cos(k * pi / 16), y + radius * sin(k * pi / 16)) for k in range(33)]
            yield LineString(points)


def _area(placement: Placement, cells: Iterable[Index]) -> BaseGeometry:
    """Return the area on the board that cells (column, row) cover, in millimetres, smaller by 0.3 mm on all sides."""
    half = placement.pitch / 2
    squares = []
    for cell in cells:
        x, y = placement.at(*cell)
        squares.append(box(x - half, y - half, x + half, y + half).buffer(_OVERLAP, join_style="mitre"))
    return union_all(squares).buffer(-_INSET - _OVERLAP, join_style="mitre")


def _hatched(area: BaseGeometry) -> Iterator[LineString]:
    """Yield the outline of an area, and oblique parallel lines inside it."""
    if area.is_empty:
        return
    for part in getattr(area, "geoms", [area]):
        yield LineString(part.exterior.coords)
        yield from (LineString(ring.coords) for ring in part.interiors)
    x0, y0, x1, y1 = area.bounds
    step = _HATCH * 2**0.5
    lines = [
        LineString([(x0 + k * step - (y1 - y0), y1), (x0 + k * step, y0)])
        for k in range(1, int((x1 - x0 + y1 - y0) / step) + 1)
    ]
    inside = MultiLineString(lines).intersection(area)
    yield from (piece for piece in getattr(inside, "geoms", [inside]) if isinstance(piece, LineString))


def _border(placement: Placement) -> Iterator[LineString]:
    """Yield the border of the grid, with short oblique lines outside the sides that act as obstacles.

    Such sides have resistors to the obstacle rail.
    """
    columns, rows = placement.shape
    (x0, y0), (x1, y1) = placement.at(-0.5, rows - 0.5), placement.at(columns - 0.5, -0.5)
    corners = ((x0, y0), (x1, y0), (x1, y1), (x0, y1))
    sides = zip(corners, (*corners[1:], corners[0]), strict=True)
    wiring = placement.circuit.wiring
    for number, (start, stop) in enumerate(sides):
        yield LineString([start, stop])
        axis = (number + 1) % 2  # the upper and the lower side lie across the second axis
        if wiring.edges(placement.circuit.space)[axis] != "obstacle" or wiring.is_driven:
            continue
        (ax, ay), (bx, by) = start, stop
        length = abs(bx - ax) + abs(by - ay)
        along, out = ((bx - ax) / length, (by - ay) / length), ((by - ay) / length, (ax - bx) / length)
        for k in range(int(length / 1.27)):
            x, y = ax + along[0] * 1.27 * (k + 0.5), ay + along[1] * 1.27 * (k + 0.5)
            yield LineString([(x, y), (x + 0.7 * (out[0] + along[0]), y + 0.7 * (out[1] + along[1]))])
