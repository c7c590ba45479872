"""Types for layouts in nanometres: design rules of a process, drawn cells with placements and labels; via arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from resgrid.processes.process import Resistor

Layer = tuple[int, int]
"""Layer number and data type number of a layer in a GDSII file."""


@dataclass(frozen=True)
class MetalRules:
    """Rules of a metal layer and of the vias to the metal above it.

    Attributes
    ----------
    name : str
        Name of the metal in the process.
    layer, text : (int, int)
        Layers of the metal's shapes and of its labels.
    width, space : int
        Smallest width and spacing of the metal, in nanometres.
    area : int
        Smallest area of a shape, in nm^2.
    current : float or None
        Largest direct current per width, in A/m (mA/mm), None if the process states none.
    sheet : float
        Sheet resistance, in ohms per square.
    via, via_layer, via_size, via_space, via_enclosure
        Name and layer of the vias to the next metal above; edge length, spacing, and enclosure by both metals, in
        nanometres.  For the highest metal the name is empty, and the other values have no meaning.
    """

    name: str
    layer: Layer
    text: Layer
    width: int
    space: int
    sheet: float
    area: int = 0
    current: float | None = None
    via: str = ""
    via_layer: Layer = (0, 0)
    via_size: int = 0
    via_space: int = 0
    via_enclosure: int = 0


@dataclass(frozen=True)
class Cover:
    """A layer that covers resistors.

    `name`: name of the layer in the process; `layer`: GDSII numbers of the layer; `beside`, `beyond`: distances by
    which the layer extends past a resistor across and along the current; `width`, `space`: smallest width and spacing
    of the layer, 0 without a rule; lengths are in nanometres.
    """

    name: str
    layer: Layer
    beside: int
    beyond: int
    width: int
    space: int


@dataclass(frozen=True)
class LayoutRules:
    """Rules for drawing an array of resistors in a process; lengths are in nanometres.

    Attributes
    ----------
    process : str
        Name of the process and its resistor, such as ``"ihp-sg13g2:rppd"``.
    resistor : Resistor
        Electrical figures of the resistor.
    grid : int
        Manufacturing grid.
    body, ends : mapping of str to (int, int)
        Layers drawn on the bodies and on the ends of resistors, by name.
    contact : (int, int)
        Layer of the contacts.
    width, body_length, space : int
        Smallest width and length of the body, and spacing of resistors.
    width_offset : int
        Electrical width of the body minus its drawn width.
    head : int
        Smallest length of an end.
    body_covers, covers : tuple of Cover
        Layers that cover only the bodies of resistors, such as a salicide block; and layers that cover bodies and ends,
        drawn as one rectangle over the whole array.
    contact_size, contact_space, contact_enclosure, contact_distance : int
        Edge length and spacing of contacts, enclosure by the end, and distance of a contact from the body.
    contact_metal : int
        Enclosure of a contact by the lowest metal.
    metals : tuple of MetalRules
        The metals, from the lowest one, at least three.
    pad, pad_space, pad_opening : int
        Edge length and spacing of pads, and enclosure of the opening of the passivation by the pad.
    pad_layers : tuple of (int, int)
        Layers of a pad without its metal.
    passivation : (int, int) or None
        Layer of the openings of pads, if there is one.
    outline : (int, int)
        Layer of the outline of the whole layout.
    """

    process: str
    resistor: Resistor
    grid: int
    body: Mapping[str, Layer]
    ends: Mapping[str, Layer]
    contact: Layer
    width: int
    body_length: int
    space: int
    width_offset: int
    head: int
    body_covers: tuple[Cover, ...]
    covers: tuple[Cover, ...]
    contact_size: int
    contact_space: int
    contact_enclosure: int
    contact_distance: int
    contact_metal: int
    metals: tuple[MetalRules, ...]
    pad: int
    pad_space: int
    pad_opening: int
    pad_layers: tuple[Layer, ...]
    passivation: Layer | None
    outline: Layer

    @property
    def overlap(self) -> int:
        """Largest overlap, across the current, of the layers that cover only resistor bodies (`body_covers`), in nm."""
        return max((cover.beside for cover in self.body_covers), default=0)

    @property
    def cover_space(self) -> int:
        """Largest of the minimum spacings of the layers that cover only resistor bodies (`body_covers`), in nm."""
        return max((cover.space for cover in self.body_covers), default=0)

    def up(self, length: float) -> int:
        """Return the smallest multiple of the manufacturing grid that is at least `length` nanometres."""
        return -int(-length // self.grid) * self.grid

    def even(self, length: float) -> int:
        """Return the smallest multiple of twice the manufacturing grid that is at least `length` nanometres.

        Half of the result is then on the grid.
        """
        return -int(-length // (2 * self.grid)) * 2 * self.grid

    def resistance(self, area: int, width: int, corners: int) -> float:
        """Return the resistance of a drawn body, in ohms.

        ``R = sheet * (straight / (width + width_offset) + corners * bend_squares) + 2 * end_resistance / width`` with
        ``straight = area / width - corners * width``; the typical sheet resistance ``sheet`` (ohms per square),
        ``bend_squares`` and ``end_resistance`` are those of `resistor`.  `area`: area of the body in nm^2; `width`: its
        width in nm; `corners`: number of its right-angled corners.
        """
        straight = (area - corners * width * width) / width
        squares = straight / (width + self.width_offset) + corners * self.resistor.bend_squares
        return self.resistor.sheet_resistance * squares + 2e9 * self.resistor.end_resistance / width

    def length(self, resistance: float, width: int, corners: int) -> float:
        """Return the length of the body of a resistor along its centre line, in nanometres, not rounded to the grid.

        At corners the centre line runs through the centre of the corner's square. If the ends alone exceed the
        resistance, the result is negative. `resistance`: resistance in ohms; `width`: width of the body in nm;
        `corners`: number of its right-angled corners.
        """
        body = resistance - 2e9 * self.resistor.end_resistance / width
        squares = body / self.resistor.sheet_resistance - corners * self.resistor.bend_squares
        return squares * (width + self.width_offset) + corners * width


Box = tuple[Layer, int, int, int, int]
"""A rectangle: its layer and its lower left and upper right corners x0, y0, x1, y1, in nanometres."""


@dataclass(frozen=True)
class CellPlacement:
    """A cell placed once or as a regular array; lengths are in nanometres.

    `cell`: name of the placed cell; `x`, `y`: place of the origin of its first copy; `columns`, `rows`: numbers of
    copies along x and y; `dx`, `dy`: distances between copies along x and y.
    """

    cell: str
    x: int
    y: int
    columns: int = 1
    rows: int = 1
    dx: int = 0
    dy: int = 0


@dataclass(frozen=True)
class Label:
    """A label of a cell.

    `text`: its characters; `x`, `y`: its place in nanometres from the origin of the cell; `layer`: its layer in GDSII.
    """

    text: str
    x: int
    y: int
    layer: Layer


@dataclass(frozen=True)
class DrawnCell:
    """A cell of a GDSII or OASIS file.

    `name`: its name; `boxes`: rectangles; `placements`: placements of other cells; `labels`: texts.
    """

    name: str
    boxes: tuple[Box, ...] = ()
    placements: tuple[CellPlacement, ...] = ()
    labels: tuple[Label, ...] = ()


def fill_vias(metal: MetalRules, x0: int, y0: int, x1: int, y1: int, grid: int) -> CellPlacement:
    """Return a regular array of vias from a metal to the next one above, centred in a rectangle; at least one via.

    `x0`, `y0`, `x1`, `y1`: rectangle of both metals, in nanometres; `grid`: manufacturing grid in nanometres.
    """
    pitch, margin = metal.via_size + metal.via_space, 2 * metal.via_enclosure
    counts, starts = [], []
    for low, high in ((x0, x1), (y0, y1)):
        count = max(1, (high - low - margin + metal.via_space) // pitch)
        first = low + (high - low - (count * pitch - metal.via_space)) // 2
        counts.append(count)
        starts.append(first - first % grid)
    return CellPlacement(metal.via, starts[0], starts[1], counts[0], counts[1], pitch, pitch)
