"""Faults for layouts: each function changes the flattened shapes of a layout in one place.

Tests internals: `resgrid.hardware.layout`, `resgrid.hardware.layout_files`, `resgrid.hardware.layout_rules`.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import gdstk

from resgrid.hardware.layout import TOP, Layout
from resgrid.hardware.layout_files import DATE
from resgrid.hardware.layout_rules import Layer

Mutation = Callable[["Shapes"], tuple[float, float]]


class Shapes:
    """Flattened shapes of a layout; places are in micrometres."""

    def __init__(self, file: Path, layout: Layout) -> None:
        self.library = gdstk.read_gds(str(file))
        self.top = next(cell for cell in self.library.cells if cell.name == TOP)
        self.top.flatten()
        self.layout, self.rules, self.tile = layout, layout.rules, layout.tile
        self.width = layout.resistors[0].width * 1e-3
        self.pitch = (self.tile.px * 1e-3, self.tile.py * 1e-3)

    def on(self, layer: Layer) -> list[Any]:
        """Polygons on a layer."""
        return [shape for shape in self.top.polygons if (shape.layer, shape.datatype) == layer]

    def near(self, layer: Layer, x: float, y: float) -> Any:
        """The polygon on a layer whose centre is nearest to a place."""

        def distance(shape: Any) -> float:
            (x0, y0), (x1, y1) = shape.bounding_box()
            return (x - (x0 + x1) / 2) ** 2 + (y - (y0 + y1) / 2) ** 2

        return min(self.on(layer), key=distance)

    def box(self, layer: Layer, x0: float, y0: float, x1: float, y1: float) -> None:
        """Add a rectangle."""
        self.top.add(gdstk.rectangle((x0, y0), (x1, y1), layer=layer[0], datatype=layer[1]))

    def cut(self, layer: Layer, x0: float, y0: float, x1: float, y1: float) -> None:
        """Remove a rectangle from all shapes of a layer."""
        shapes = self.on(layer)
        kept = gdstk.boolean(shapes, gdstk.rectangle((x0, y0), (x1, y1)), "not", 1e-4, *layer)
        self.top.remove(*shapes)
        self.top.add(*kept)

    def cut_body(self, x0: float, y0: float, x1: float, y1: float) -> None:
        """Remove a rectangle from all layers of bodies."""
        for layer in self.rules.body.values():
            self.cut(layer, x0, y0, x1, y1)

    def box_body(self, x0: float, y0: float, x1: float, y1: float) -> None:
        """Add a rectangle to all layers of bodies."""
        for layer in self.rules.body.values():
            self.box(layer, x0, y0, x1, y1)

    def node(self, i: int, j: int) -> tuple[float, float]:
        """Place of the node of a cell."""
        return i * self.pitch[0], j * self.pitch[1]

    def body(self, i: int, j: int, *, upper: bool = False) -> tuple[float, float]:
        """Lower left end of the body of the resistor along x, or along y, of a tile."""
        x, y = self.node(i, j)
        return x + self.tile.start * 1e-3, y + self.tile.upper * 1e-3 * upper

    def label(self, text: str) -> Any:
        """The first label with a text."""
        return next(label for label in self.top.labels if label.text == text)

    def write(self, file: Path) -> None:
        """Write the shapes."""
        library = gdstk.Library(TOP, unit=1e-6, precision=1e-9)
        library.add(self.top)
        library.write_gds(str(file), timestamp=DATE)


def shifted_contact(s: Shapes) -> tuple[float, float]:
    x, y = s.node(2, 1)
    s.near(s.rules.contact, x, y).translate(0, 1.1)
    return x, y


def missing_contact(s: Shapes) -> tuple[float, float]:
    x, y = s.node(1, 1)
    s.top.remove(s.near(s.rules.contact, x, y))
    return x, y


def missing_via_of_goal(s: Shapes) -> tuple[float, float]:
    x, y = s.node(*GOAL)
    s.top.remove(s.near(s.rules.metals[1].via_layer, x, y))
    return x, y


def missing_vias_of_obstacle(s: Shapes) -> tuple[float, float]:
    x, y = s.node(-1, 2)
    s.cut(s.rules.metals[0].via_layer, x - 0.5, y - 0.5, x + 0.5, y + s.pitch[1])
    return x, y


def wrong_length(s: Shapes) -> tuple[float, float]:
    x, y = s.body(1, 2)
    s.cut_body(x, y - s.width / 2, x + 0.05, y + s.width / 2)
    s.box(s.rules.ends["poly"], x, y - s.width / 2, x + 0.05, y + s.width / 2)
    return x, y


def long_body(s: Shapes) -> tuple[float, float]:
    x, y = s.body(3, 1, upper=True)
    s.box_body(x - 0.05, y - s.width / 2, x, y + s.width / 2)
    return x, y


def narrow_body(s: Shapes) -> tuple[float, float]:
    x, y = s.body(1, 1)
    s.cut_body(x - 0.01, y + s.width / 2 - 0.05, x + 20, y + s.width / 2)
    return x, y


def notched_body(s: Shapes) -> tuple[float, float]:
    x, y = s.body(1, 1)
    s.cut_body(x + 1, y + s.width / 2 - 0.1, x + 1.2, y + s.width / 2)
    return x, y


def broken_body(s: Shapes) -> tuple[float, float]:
    x, y = s.body(2, 2)
    s.cut_body(x + 1, y - 0.3, x + 1.5, y + 0.3)
    return x, y


def short_between_rails(s: Shapes) -> tuple[float, float]:
    x, y = s.node(*GOAL)
    s.box(s.rules.metals[1].layer, x - 0.1, y, x + 0.1, y + s.tile.stripe[0] * 1e-3 + 0.2)
    return x, y


def short_between_nodes(s: Shapes) -> tuple[float, float]:
    x, y = s.node(1, 1)
    s.box(s.rules.metals[0].layer, x, y - 0.2, x + s.pitch[0], y + 0.2)
    return x, y


def open_strap(s: Shapes) -> tuple[float, float]:
    x, y = s.node(2, 1)
    end = x + s.pitch[0] - s.layout.tile.wire * 1e-3 / 2
    s.cut(s.rules.metals[0].layer, end - 0.35, y - 0.1, end - 0.1, y + s.tile.upper * 1e-3)
    return x, y


def open_bar(s: Shapes) -> tuple[float, float]:
    x, y = s.node(3, 2)
    s.cut(s.rules.metals[0].layer, x - 0.4, y + 0.8, x + 0.4, y + 1.1)
    return x, y


def open_trunk(s: Shapes) -> tuple[float, float]:
    trunk = s.layout.rails.trunks[0]
    y = s.layout.rails.bottom * 1e-3
    s.cut(s.rules.metals[2].layer, trunk.x * 1e-3 - 2, y - 0.5, trunk.x * 1e-3 + 2, y + 0.5)
    return trunk.x * 1e-3, y


def swapped_pads(s: Shapes) -> tuple[float, float]:
    first, second = s.label("goal_0"), s.label("obstacle")
    first.text, second.text = second.text, first.text
    return first.origin


def swapped_nodes(s: Shapes) -> tuple[float, float]:
    first, second = s.label("n_1_1"), s.label("n_2_1")
    first.text, second.text = second.text, first.text
    return s.node(1, 1)


def missing_resistor(s: Shapes) -> tuple[float, float]:
    x, y = s.body(1, 1)
    for cut in (s.cut_body, lambda *box: s.cut(s.rules.ends["poly"], *box)):
        cut(x - 1, y - 0.4, x + s.pitch[0] - 1, y + s.tile.upper * 1e-3 - 0.4)
    return x, y


def extra_resistor(s: Shapes) -> tuple[float, float]:
    x, y = s.node(0, -4)
    s.box(s.rules.ends["poly"], x, y, x + 5, y + 0.5)
    s.box_body(x + 1, y, x + 4, y + 0.5)
    return x, y


def thin_metal(s: Shapes) -> tuple[float, float]:
    x, y = s.node(1, 2)
    s.cut(s.rules.metals[0].layer, x - 0.5, y + 0.6, x + 0.03, y + 0.9)
    return x, y


def near_metal(s: Shapes) -> tuple[float, float]:
    x, y = s.node(1, 2)
    right = max(x1 for (_, _), (x1, _) in [s.near(s.rules.metals[0].layer, x, y + 0.8).bounding_box()])
    s.box(s.rules.metals[0].layer, right + 0.1, y + 0.6, right + 1, y + 1)
    return x, y


def large_via(s: Shapes) -> tuple[float, float]:
    x, y = s.node(*GOAL)
    s.box(s.rules.metals[0].via_layer, x - 0.2, y - 0.2, x + 0.2, y + 0.2)
    return x, y


def moved_label(s: Shapes) -> tuple[float, float]:
    s.label("goal_0").origin = s.node(0, 9)
    return s.node(0, 9)


GOAL = (4, 3)
"""A goal cell of the layout that is changed."""

MUTATIONS: tuple[Mutation, ...] = (
    shifted_contact, missing_contact, missing_via_of_goal, missing_vias_of_obstacle, wrong_length, long_body,
    narrow_body, notched_body, broken_body, short_between_rails, short_between_nodes, open_strap, open_bar, open_trunk,
    swapped_pads, swapped_nodes, missing_resistor, extra_resistor, thin_metal, near_metal, large_via, moved_label,
)  # fmt: skip
