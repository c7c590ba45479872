"""Design rules of a layout: layers, widths, spacings and enclosures of a process, in nanometres."""

from __future__ import annotations

from dataclasses import dataclass

Layer = tuple[int, int]
"""Number and data type of a layer in a GDSII file."""


@dataclass(frozen=True)
class MetalRules:
    """Rules of a metal layer and of the vias to the metal above it.

    Attributes
    ----------
    name : str
        Name of the metal in the process.
    layer, text : (int, int)
        Layers of the shapes and of the labels.
    width, space : int
        Smallest width and spacing of the metal, in nanometres.
    area : int
        Smallest area of a shape, in nm^2.
    current : float or None
        Largest direct current per width, in A/m (mA/mm), None if the process states none.
    sheet : float
        Sheet resistance, in ohms per square.
    via, via_layer, via_size, via_space, via_enclosure
        Name and layer of the vias to the next metal; edge length, spacing, and enclosure by both metals, in nanometres.
        The name is empty for the highest metal.
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
class LayoutRules:
    """Rules for drawing an array of resistors in a process; lengths are in nanometres.

    Attributes
    ----------
    process : str
        Name of the process and its resistor, such as ``"ihp-sg13g2:rppd"``.
    grid : int
        Manufacturing grid.
    sheet : float
        Sheet resistance of the resistor's body, in ohms per square.
    end_resistance : float
        Resistance of one end times its width, in ohm metres.
    corner_squares : float
        Number of squares that a right-angled corner of the body counts for.
    width_offset : int
        Electrical width of the body minus its drawn width.
    poly, marker, contact : (int, int)
        Layers of the resistive material, of the marker that defines the body, and of the contacts.
    covers : tuple of (name, layer, enclosure, width, space)
        Layers that cover the whole resistor, such as implants.
    width, body_length, poly_space : int
        Smallest width and length of the body, and spacing of the material.
    marker_width, marker_space, marker_enclosure : int
        Width and spacing of the marker, and its enclosure of the body across the current.
    contact_size, contact_space, contact_enclosure, contact_marker : int
        Edge length and spacing of contacts, enclosure by the material, and distance of a contact from the marker.
    contact_metal : int
        Enclosure of a contact by the lowest metal.
    metals : tuple of MetalRules
        The metals, from the lowest one, at least three.
    pad, pad_space, pad_opening : int
        Edge length and spacing of bond or probe pads, and enclosure of the passivation's opening by the pad.
    passivation, outline : (int, int)
        Layers of the openings of pads, and of the outline of the block.
    matching : float or None
        Standard deviation of the relative resistance times the square root of the body's area, in metres.
    """

    process: str
    grid: int
    sheet: float
    end_resistance: float
    corner_squares: float
    width_offset: int
    poly: Layer
    marker: Layer
    contact: Layer
    width: int
    body_length: int
    poly_space: int
    marker_width: int
    marker_space: int
    marker_enclosure: int
    contact_size: int
    contact_space: int
    contact_enclosure: int
    contact_marker: int
    contact_metal: int
    metals: tuple[MetalRules, ...]
    pad: int
    pad_space: int
    pad_opening: int
    passivation: Layer
    outline: Layer
    covers: tuple[tuple[str, Layer, int, int, int], ...] = ()
    matching: float | None = None

    def up(self, length: float) -> int:
        """Return the smallest multiple of the manufacturing grid that is at least `length` nanometres."""
        return -int(-length // self.grid) * self.grid

    def even(self, length: float) -> int:
        """Return the smallest multiple of twice the grid that is at least `length`, so that its half is on the grid."""
        return -int(-length // (2 * self.grid)) * 2 * self.grid

    def resistance(self, area: int, width: int, corners: int) -> float:
        """Return the resistance of a drawn body, in ohms.

        ``R = sheet * (straight / (width + width_offset) + corners * corner_squares) + 2 * end_resistance / width`` with
        ``straight = area / width - corners * width``.  `area`: area of the body in nm^2; `width`: its width in nm;
        `corners`: number of its right-angled corners.
        """
        straight = (area - corners * width * width) / width
        squares = straight / (width + self.width_offset) + corners * self.corner_squares
        return self.sheet * squares + 2e9 * self.end_resistance / width

    def length(self, resistance: float, width: int, corners: int) -> float:
        """Return the length of a body along its centre line, in nanometres, from a corner's centre to the next one's.

        `resistance`: resistance in ohms; `width`: width in nm; `corners`: number of right-angled corners.
        """
        squares = (resistance - 2e9 * self.end_resistance / width) / self.sheet - corners * self.corner_squares
        return squares * (width + self.width_offset) + corners * width


Box = tuple[Layer, int, int, int, int]
"""A rectangle: its layer and its lower left and upper right corners x0, y0, x1, y1, in nanometres."""


@dataclass(frozen=True)
class Placement:
    """A cell placed once or as a regular array; lengths are in nanometres.

    `cell`: name of the placed cell; `x`, `y`: origin of its first copy; `columns`, `rows`: numbers of copies along x
    and y; `dx`, `dy`: distances between copies.
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
    """A text at a place, in nanometres, on a layer."""

    text: str
    x: int
    y: int
    layer: Layer


@dataclass(frozen=True)
class DrawnCell:
    """A cell of a layout: rectangles, placed cells and labels."""

    name: str
    boxes: tuple[Box, ...] = ()
    placements: tuple[Placement, ...] = ()
    labels: tuple[Label, ...] = ()


def fill_vias(metal: MetalRules, x0: int, y0: int, x1: int, y1: int, grid: int) -> Placement:
    """Return an array of vias from a metal to the next one that fills a rectangle, centred in it; at least one via.

    `x0`, `y0`, `x1`, `y1`: rectangle of both metals, in nanometres; `grid`: manufacturing grid.
    """
    pitch, margin = metal.via_size + metal.via_space, 2 * metal.via_enclosure
    counts, starts = [], []
    for low, high in ((x0, x1), (y0, y1)):
        count = max(1, (high - low - margin + metal.via_space) // pitch)
        first = low + (high - low - (count * pitch - metal.via_space)) // 2
        counts.append(count)
        starts.append(first - first % grid)
    return Placement(metal.via, starts[0], starts[1], counts[0], counts[1], pitch, pitch)
