"""Sizes and rectangles of the resistors of a layout, drawn as serpentines.

Every resistor is a body of constant width with an odd number of parallel rows, so that its two contacts are on opposite
sides.  All resistors have the same width and orientation, which improves matching.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from resgrid.errors import InputError
from resgrid.hardware.layout_rules import Box, LayoutRules

MOST_ROWS = 61
"""Largest number of parallel rows of a serpentine resistor."""

LONGEST = 1e7
"""Largest length of a resistor's body along its centre line, in nanometres; larger resistances are rejected."""

WIDEST = 10_000_000
"""Largest width of the body of a resistor, in nanometres; wider resistors are rejected."""


@dataclass(frozen=True)
class Serpentine:
    """A drawn resistor whose body runs back and forth in rows along x; lengths are in nanometres.

    The body begins at x = 0 in row 0, whose centre is at y = 0; further rows lie above. `rows`: odd number of rows;
    `turn`: x of the centre of the turns on the right, 0 for one row; `end`: x at which the body ends in the last row;
    `area`: area of the body in nm^2; `width`: width of the body; `corners`: number of right-angled corners;
    `resistance`: resistance in ohms.
    """

    rows: int
    turn: int
    end: int
    area: int
    width: int
    corners: int
    resistance: float


@dataclass(frozen=True)
class Head:
    """Measures of the two ends of all resistors, which contain the contacts, in nanometres.

    Ends lie to the left and to the right of the body; heights are along y. `length`: length along x of an end beyond
    the body; `contact`: distance along x of the contacts' centre from the body; `height`: height of an end; `metal`:
    half the height of the metal on the contacts; `bar`: width of a vertical bar of metal 1 over the contacts; `pitch`:
    distance between the centres of neighbouring rows of the body; `inset`: distance along x between the beginning of
    the body and the centre of the turns on the left.
    """

    length: int
    contact: int
    height: int
    metal: int
    bar: int
    pitch: int
    inset: int


def head_of(rules: LayoutRules, width: int) -> Head:
    """Return the measures of the ends of resistors, and the pitch of their rows.

    `width`: width of the bodies of the resistors, in nanometres.
    """
    size, metal = rules.contact_size, rules.metals[0]
    length = rules.up(max(rules.head, rules.contact_distance + size + rules.contact_enclosure))
    height = rules.even(max(width, size + 2 * rules.contact_enclosure))
    bar = rules.even(max(size + 2 * rules.contact_metal, metal.width, metal.via_size + 2 * metal.via_enclosure))
    column = contact_column(rules, height)
    half = rules.up(max(column[-1] + size - column[0] + 2 * rules.contact_metal, bar) / 2)
    row = rules.up(max(width, (height + width) / 2) + rules.space)
    inset = rules.up(rules.overlap + width / 2)
    return Head(length, rules.up(rules.contact_distance) + size // 2, height, half, bar, row, inset)


def contact_column(rules: LayoutRules, height: int) -> list[int]:
    """Return the y of the lower edge of each contact of an end, relative to the centre of the row, in nanometres.

    `height`: height of the end, in nanometres.
    """
    pitch = rules.contact_size + rules.contact_space
    count = max(1, (height - 2 * rules.contact_enclosure + rules.contact_space) // pitch)
    first = -(count * pitch - rules.contact_space) // 2
    first -= first % rules.grid
    return [first + number * pitch for number in range(count)]


def body_width(rules: LayoutRules, resistances: Sequence[float], width: float | None, matching: float | None) -> int:
    """Return the width of all resistors in nanometres, an even multiple of the manufacturing grid.

    `resistances`: values in ohms; `width`: requested width in metres, rounded up, None for the smallest width that the
    rules and `matching` permit; `matching`: required standard deviation of the smallest resistance, relative to its
    mean, None for no limit. The deviation is ``coefficient / sqrt(width * length)`` with the mismatch coefficient
    `Resistor.pelgrom` of the process (Pelgrom et al. 1989). Raises InputError for values that cannot be drawn, and for
    `width` together with `matching`.
    """
    least = rules.even(rules.width)
    if width is not None and matching is not None:
        raise InputError("width and matching both determine the width of the resistors; give one of them")
    if width is not None:
        drawn = rules.even(width * 1e9 - 1e-6)
        if drawn < least:
            raise InputError(
                f"width = {width:g} m is below {least * 1e-9:.3g} m, the smallest width of a resistor in "
                f"{rules.process}; choose a larger width"
            )
        if drawn > WIDEST:
            raise InputError(
                f"width = {width:g} m exceeds {WIDEST * 1e-9:g} m, the largest width of a resistor; choose a smaller "
                "width"
            )
        return drawn
    drawn = least if matching is None else _matched_width(rules, min(resistances), matching)
    for _ in range(60):
        length = rules.length(min(resistances), drawn, 0)
        if length <= 0 or length >= rules.body_length:
            break
        drawn = rules.even(max(drawn + 2 * rules.grid, drawn * rules.body_length / length))
    return drawn


def _matched_width(rules: LayoutRules, resistance: float, matching: float) -> int:
    """Return the smallest width in nanometres at which the standard deviation of a resistor is at most `matching`.

    The standard deviation is a fraction of the mean resistance. `resistance`: mean resistance in ohms. Raises
    InputError if the process states no mismatch, or the resistor becomes too wide.
    """
    if rules.resistor.mismatch is None:
        raise InputError(f"{rules.process} states no mismatch of resistors; give the width instead of matching")
    if not 0 < matching < 1:
        raise InputError(f"matching = {matching:g} must be a fraction between 0 and 1, such as 0.01 for 1 %")
    drawn = rules.even(rules.width)
    for _ in range(60):  # the length is almost proportional to the width
        length = rules.length(resistance, drawn, 0)
        if length <= 0:
            break
        coefficient = rules.resistor.pelgrom(drawn * 1e-3, length * 1e-3) or 0.0
        side = coefficient * 10.0 / matching  # of a square with the area of the body
        if side > WIDEST:
            raise InputError(
                f"matching = {matching:g} needs a resistor of {side * 1e-9:.3g} x {side * 1e-9:.3g} m, and a body is "
                f"at most {WIDEST * 1e-9:g} m wide; choose a larger matching"
            )
        if drawn * length >= side**2:
            break
        drawn = rules.even(max(drawn + 2 * rules.grid, side * (drawn / length) ** 0.5))
    return drawn


def serpentine(rules: LayoutRules, head: Head, width: int, resistance: float, rows: int) -> Serpentine | None:
    """Return the resistor with `rows` rows whose resistance is nearest to a value; None if its body would be too short.

    A body of one row is too short if it is shorter than the smallest length in the process. A body of several rows is
    too short if the turns on the left and on the right would lie closer together than the spacing rule permits. `head`:
    measures of the ends; `width`: width of the body in nanometres; `resistance`: required resistance in ohms; `rows`:
    odd number of rows.
    """
    corners = 2 * (rows - 1)
    length = round(rules.length(resistance, width, corners) / rules.grid) * rules.grid
    if rows == 1:
        if length < rules.body_length:
            return None
        return Serpentine(1, 0, length, length * width, width, 0, rules.resistance(length * width, width, 0))
    straight = length - (rows - 1) * head.pitch
    turn = (straight + (rows - 2) * head.inset) // rows // rules.grid * rules.grid
    end = straight - (rows - 1) * (turn - head.inset)
    if turn - head.inset < 2 * width + rules.space:
        return None
    area = length * width
    return Serpentine(rows, turn, end, area, width, corners, rules.resistance(area, width, corners))


def size_resistors(rules: LayoutRules, head: Head, width: int, resistances: Sequence[float]) -> list[Serpentine]:
    """Return one drawn resistor for each resistance, in the order of `resistances`.

    One upper limit of the number of rows is chosen for all resistors, so that width plus height of a tile (the drawing
    of one cell) becomes smallest. Within this limit, each resistor has the number of rows for which its drawing ends at
    the smallest x. `width`: width of the bodies in nanometres; `resistances`: different values in ohms. Raises
    InputError for a resistance that cannot be drawn.
    """
    for value in resistances:
        if not rules.body_length - rules.grid / 2 <= rules.length(value, width, 0) <= LONGEST:
            low = rules.resistance(rules.body_length * width, width, 0)
            high = rules.resistance(round(LONGEST) * width, width, 0)
            raise InputError(
                f"a resistor of {value:.6g} ohm cannot be drawn in {rules.process} at a width of {width * 1e-3:g} um: "
                f"the range is {low:.3g} to {high:.3g} ohm; change resistance, the conductivities, the wall resistance "
                "or the width of the resistors"
            )
    choices: list[list[Serpentine]] = []
    shapes: list[dict[int, Serpentine]] = [{} for _ in resistances]
    for rows in range(1, MOST_ROWS + 1, 2):
        for value, drawn in zip(resistances, shapes, strict=True):
            shape = serpentine(rules, head, width, value, rows)
            if shape is not None:
                drawn[rows] = shape
        if all(shapes):
            choices.append([min(drawn.values(), key=lambda shape: shape.end) for drawn in shapes])
    return min(choices, key=lambda choice: _half_perimeter(head, choice))


def _half_perimeter(head: Head, shapes: Sequence[Serpentine]) -> int:
    """Return an estimate of width plus height, in nanometres, of a tile whose resistors have the given shapes."""
    rows = max(shape.rows for shape in shapes)
    return max(shape.end for shape in shapes) + 2 * head.length + 2 * (rows + 1) * head.pitch


def draw_resistor(rules: LayoutRules, head: Head, shape: Serpentine) -> list[Box]:
    """Return the rectangles of a resistor: body, ends, covers of the body, and contacts, but not the metal on contacts.

    The body begins at x = 0, and the centre of its first row is at y = 0, in nanometres. `head`: measures of the ends.
    """
    boxes = [(layer, *box) for layer in rules.body.values() for box in _body(head, shape)]
    half, last = shape.width // 2, (shape.rows - 1) * head.pitch
    for cover in rules.body_covers:
        low, high = -half - cover.beside, last + half + cover.beside
        boxes.append((cover.layer, -cover.beyond, low, shape.end + cover.beyond, high))
    for y, x0, contact in ((0, -head.length, -head.contact), (last, shape.end, shape.end + head.contact)):
        end = (x0, y - head.height // 2, x0 + head.length, y + head.height // 2)
        boxes += [(layer, *end) for layer in rules.ends.values()]
        left = contact - rules.contact_size // 2
        for low in contact_column(rules, head.height):
            boxes.append((rules.contact, left, y + low, left + rules.contact_size, y + low + rules.contact_size))
    return boxes


def _body(head: Head, shape: Serpentine) -> list[tuple[int, int, int, int]]:
    """Return the rectangles (x0, y0, x1, y1) of a body, in nanometres: its rows and its turns."""
    half, boxes = shape.width // 2, []
    for row in range(shape.rows):
        left = 0 if row == 0 else head.inset - half
        right = shape.end if row == shape.rows - 1 else shape.turn + half
        boxes.append((left, row * head.pitch - half, right, row * head.pitch + half))
        if row:
            x = shape.turn if row % 2 else head.inset
            boxes.append((x - half, (row - 1) * head.pitch + half, x + half, row * head.pitch - half))
    return boxes
