"""Types for a chip process: layers, cuts, bond pads and resistors, with lengths in micrometres."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Len

from resgrid._internal.values import brief
from resgrid.errors import InputError

Corner = Literal["typical", "low", "high"]
"""Corner of a process: typical, lowest or highest sheet resistance."""

Positive = Annotated[float, Gt(0)]
AtLeastZero = Annotated[float, Ge(0)]
GdsNumber = Annotated[int, Ge(0)]


@brief
@dataclass(frozen=True)
class Layer:
    """A drawn layer. An attribute is None if the source of the process does not give the figure.

    Attributes
    ----------
    gds : tuple of int
        Layer and datatype numbers in GDSII files.
    min_width, min_space, max_width : float or None
        Smallest width, smallest distance of shapes, and largest width, in micrometres.
    wide_space : tuple of tuple of float
        Pairs of a width and the distance that shapes wider than this width need, in micrometres.
    min_area : float or None
        Smallest area of a shape, in square micrometres.
    sheet_resistance : float or None
        Resistance in ohms per square.
    current_density : float or None
        Largest direct current per width, in A/m.
    area_capacitance, edge_capacitance : float or None
        Capacitance to the substrate, in F/m^2 of area and in F/m of edge.

    Examples
    --------
    >>> rg.processes.Layer(gds=(8, 0), min_width=0.16, min_space=0.18)
    Layer(gds=(8, 0), min_width=0.16, min_space=0.18)
    """

    gds: tuple[GdsNumber, GdsNumber]
    min_width: Positive | None = None
    min_space: Positive | None = None
    max_width: Positive | None = None
    wide_space: tuple[tuple[Positive, Positive], ...] = ()
    min_area: Positive | None = None
    sheet_resistance: Positive | None = None
    current_density: Positive | None = None
    area_capacitance: AtLeastZero | None = None
    edge_capacitance: AtLeastZero | None = None


@brief
@dataclass(frozen=True)
class Cut:
    """A square contact or via between two layers; its own layer has the name of the cut.

    Attributes
    ----------
    below, above : str
        Names of the connected layers.
    size, space : float
        Side of a square, and smallest distance between two squares, in micrometres.
    enclosure_below, enclosure_above : float
        Smallest overlap of the layers `below` and `above` over the square on every side, in micrometres.
    array_space : float or None
        Smallest distance between squares in arrays with more than `array_rows` rows and more than `array_rows` columns,
        in micrometres; None without a rule.
    array_rows : int or None
        Largest number of rows or columns for which `space` suffices; None without a rule.
    resistance : float or None
        Resistance of one cut, in ohms; None if the source does not give it.
    max_current : float or None
        Largest direct current of one cut, in amperes; None if the source does not give it.

    Examples
    --------
    >>> cut = rg.processes.read_process("ihp-sg13g2:rppd").cuts["contact"]
    >>> cut.below, cut.above, cut.size, cut.space
    ('poly', 'metal1', 0.16, 0.18)
    """

    below: str
    above: str
    size: Positive
    space: Positive
    enclosure_below: AtLeastZero
    enclosure_above: AtLeastZero
    array_space: Positive | None = None
    array_rows: Annotated[int, Ge(1)] | None = None
    resistance: AtLeastZero | None = None
    max_current: Positive | None = None


@brief
@dataclass(frozen=True)
class Pad:
    """A square bond pad.

    Attributes
    ----------
    layers : tuple of str
        Names of the layers of the pad.
    size, space : float
        Side of a pad, and smallest distance between two pads, in micrometres.
    opening : str or None
        Name of the layer that opens the passivation, None without such a layer.
    opening_enclosure : float
        Overlap of the pad over the opening, in micrometres.

    Examples
    --------
    >>> pad = rg.processes.read_process("ihp-sg13g2:rppd").pad
    >>> pad.layers, pad.size, pad.space
    (('top_metal', 'pad'), 80.0, 8.4)
    """

    layers: Annotated[tuple[str, ...], Len(1)]
    size: Positive
    space: Positive
    opening: str | None = None
    opening_enclosure: AtLeastZero = 0.0


@brief
@dataclass(frozen=True)
class Resistor:
    """A straight resistor: a body of width W and length L between two heads with contacts.

    The resistance is ``Rs L / (W + dW) + 2 Rz / W``, with the sheet resistance ``Rs``, the width correction ``dW`` and
    the end resistance ``Rz``, all lengths in metres.  An attribute is None if the source does not give the figure.

    Attributes
    ----------
    title : str
        One line about the resistor.
    sheet_resistance : float
        Typical sheet resistance ``Rs``, in ohms per square.
    corners : mapping of str to float
        Sheet resistance at the corners ``"low"`` and ``"high"``, in ohms per square, as far as the source states them.
    width_correction : float
        Width correction ``dW``: electrical width minus drawn width, in micrometres.
    end_resistance : float
        End resistance ``Rz``: resistance of one end times the drawn width, in ohm metres.
    min_width, max_width, min_length, max_length, min_space : float or None
        Range of width and length, and smallest distance of two resistors, in micrometres; a largest value is None if
        the source states no limit.
    head_length : float
        Length of the head at each end of the body, in micrometres.
    contact_distance : float
        Distance from the body to the contacts in the head, in micrometres.
    body, ends : tuple of str
        Names of the layers drawn on the body, and on each head.
    covers : mapping of str to tuple of float
        Layers that cover body and heads, by name: overlaps across and along the current, in micrometres.
    body_covers : mapping of str to tuple of float
        Layers that cover the body only, by name: overlaps across and along the current, in micrometres.
    mismatch : float or None
        Standard deviation of the sheet resistance, in percent of its mean, times ``sqrt(W L)`` in micrometres.
    width_mismatch : float
        Standard deviation of the width times ``sqrt(L)``, in micrometres to the power 1.5.
    length_mismatch : float
        Standard deviation of the length times ``sqrt(W)``, in micrometres to the power 1.5.
    bend_squares : float
        Number of squares that a right-angled bend of the body counts for.
    tc1, tc2 : float or None
        Temperature coefficients, in 1/K and 1/K^2, relative to 27 degrees Celsius.
    gradient : float or None
        Change of the resistance from one edge of a die to the other, as a fraction of the nominal value.
    area_capacitance, edge_capacitance : float or None
        Capacitance to the substrate, in F/m^2 of area and in F/m of edge.

    Examples
    --------
    >>> rppd = rg.processes.read_process("ihp-sg13g2:rppd").resistor
    >>> round(rppd.resistance(0.5, 0.5), 3), round(rppd.length(10e3, 0.5), 3)
    (396.917, 19.189)
    >>> round(rppd.pelgrom(0.5, 19.19), 3)
    2.074
    """

    title: str
    sheet_resistance: Positive
    min_width: Positive
    min_length: Positive
    min_space: Positive
    head_length: Positive
    contact_distance: AtLeastZero
    body: Annotated[tuple[str, ...], Len(1)]
    ends: Annotated[tuple[str, ...], Len(1)]
    corners: Mapping[Literal["low", "high"], Positive] = field(default_factory=dict)
    width_correction: float = 0.0
    end_resistance: AtLeastZero = 0.0
    max_width: Positive | None = None
    max_length: Positive | None = None
    covers: Mapping[str, tuple[AtLeastZero, AtLeastZero]] = field(default_factory=dict)
    body_covers: Mapping[str, tuple[AtLeastZero, AtLeastZero]] = field(default_factory=dict)
    mismatch: AtLeastZero | None = None
    width_mismatch: AtLeastZero = 0.0
    length_mismatch: AtLeastZero = 0.0
    bend_squares: Positive = 1.0
    tc1: float | None = None
    tc2: float | None = None
    gradient: float | None = None
    area_capacitance: AtLeastZero | None = None
    edge_capacitance: AtLeastZero | None = None

    def __post_init__(self) -> None:
        for name in ("corners", "covers", "body_covers"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))
        if self.min_width + self.width_correction <= 0:
            raise InputError(f"width_correction = {self.width_correction:g} leaves no width; give a smaller magnitude")

    def at_corner(self, corner: Corner) -> float:
        """Return the sheet resistance at a corner, in ohms per square.

        Raises InputError if the process does not state this corner.
        """
        if corner != "typical" and corner not in self.corners:
            known = ", ".join(("typical", *self.corners))
            raise InputError(f"corner = {corner!r} is not known for {self.title}; there are {known}")
        return self.sheet_resistance if corner == "typical" else self.corners[corner]

    def resistance(self, length: float, width: float) -> float:
        """Return the typical resistance in ohms.

        `length`, `width`: drawn length and width of the body, in micrometres.
        """
        return self.sheet_resistance * length / (width + self.width_correction) + 2e6 * self.end_resistance / width

    def length(self, resistance: float, width: float) -> float:
        """Return the drawn length in micrometres at which a resistor of a drawn width has a resistance.

        `resistance`: typical resistance in ohms; `width`: drawn width in micrometres. Raises InputError if the ends
        alone exceed the resistance, or if the width is below the smallest one.
        """
        if width < self.min_width - 1e-9:
            raise InputError(f"width = {width:g} um is below the smallest width, {self.min_width:g} um; widen it")
        body = resistance - 2e6 * self.end_resistance / width
        if body <= 0:
            raise InputError(
                f"resistance = {resistance:g} ohm is below that of the two ends, {resistance - body:g} ohm at a width "
                f"of {width:g} um; raise the resistance or the width"
            )
        return body * (width + self.width_correction) / self.sheet_resistance

    def capacitance(self, length: float, width: float) -> float | None:
        """Return the capacitance of the body to the substrate in farads, without the heads; None if it is not known.

        `length`, `width`: drawn length and width of the body, in micrometres.
        """
        if self.area_capacitance is None:
            return None
        edge = 2 * (length + width) * 1e-6 * (self.edge_capacitance or 0.0)
        return self.area_capacitance * length * width * 1e-12 + edge

    def pelgrom(self, width: float, length: float) -> float | None:
        """Return the effective Pelgrom coefficient ``sigma sqrt(W L)``, in percent times micrometres.

        Here ``sigma`` is the standard deviation of the resistance in percent. The result is None if the process states
        no mismatch. Its square is the sum of the contributions of sheet resistance, width and length,
        ``A^2 + B^2 / W + C^2 / L``, with ``A`` = `mismatch`, ``B`` = 100 `width_mismatch` and ``C`` = 100
        `length_mismatch`. `width`, `length`: drawn width W and length L of the body, in micrometres.
        """
        if self.mismatch is None:
            return None
        edges = (100 * self.width_mismatch) ** 2 / width + (100 * self.length_mismatch) ** 2 / length
        return math.sqrt(self.mismatch**2 + edges)


@brief
@dataclass(frozen=True)
class Process:
    """A chip process with the resistor that is chosen from it.

    Attributes
    ----------
    name : str
        Name with the resistor, such as ``"ihp-sg13g2:rppd"``.
    title, license, reference : str
        Title, licence and origin of the data.
    grid : float
        Grid of which all coordinates of a layout must be multiples, in micrometres.
    layers, cuts : mapping
        Layers (`Layer`) and contacts or vias (`Cut`), by name.
    pad : Pad
        Size, distance and layers of bond pads.
    resistors : mapping of str to Resistor
        All resistors of the process, by name.

    Examples
    --------
    >>> process = rg.processes.read_process("ihp-sg13g2:rhigh")
    >>> process.layers["metal1"].gds, process.min_space("metal1"), process.enclosure("contact", "poly")
    ((8, 0), 0.18, 0.07)
    """

    name: str
    title: str
    license: str
    reference: str
    grid: Positive
    layers: Mapping[str, Layer]
    cuts: Mapping[str, Cut]
    pad: Pad
    resistors: Mapping[str, Resistor]

    def __post_init__(self) -> None:
        for name in ("layers", "cuts", "resistors"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))
        used = {*self.cuts, *(layer for cut in self.cuts.values() for layer in (cut.below, cut.above))}
        used |= {*self.pad.layers, *([self.pad.opening] if self.pad.opening else [])}
        for resistor in self.resistors.values():
            used |= {*resistor.body, *resistor.ends, *resistor.covers, *resistor.body_covers}
        if missing := sorted(used - self.layers.keys()):
            raise InputError(f"{self.title} uses layers that it does not define: {', '.join(missing)}; add them")

    @property
    def resistor(self) -> Resistor:
        """The resistor that the process was read for: the part of `name` after the colon."""
        return self.resistors[self.name.rpartition(":")[2]]

    def min_width(self, layer: str) -> float | None:
        """Return the smallest width of a layer in micrometres; None if it is not known."""
        return self.layers[layer].min_width

    def min_space(self, layer: str, width: float = 0.0) -> float | None:
        """Return the smallest distance of two shapes on a layer in micrometres; None if it is not known.

        `width`: width of the wider shape in micrometres, because wide shapes need larger distances; 0 for the rule of
        narrow shapes.
        """
        rules = [space for limit, space in self.layers[layer].wide_space if width > limit]
        return max(rules, default=self.layers[layer].min_space)

    def enclosure(self, cut: str, layer: str) -> float:
        """Return the smallest overlap in micrometres of a layer over a contact or via, on every side.

        `cut`: name of the contact or via; `layer`: name of one of the two layers that the contact or via connects.
        """
        sides = {self.cuts[cut].below: self.cuts[cut].enclosure_below}
        return (sides | {self.cuts[cut].above: self.cuts[cut].enclosure_above})[layer]
