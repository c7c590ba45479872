"""Connected copper of a board, found from its Gerber layers and drill files alone.

This is the test that a manufacturer does on a bare board: two pads belong to one net if copper connects them.  The nets
that the board file states play no part in the connection.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from resgrid.core.regions import label_components
from resgrid.hardware.excellon import Hole
from resgrid.hardware.gerber import CopperShape, pieces, subtract
from resgrid.hardware.gerber_apertures import ARC_STEPS


@dataclass(frozen=True)
class Contact:
    """A place where copper shapes with different stated nets touch.

    `nets`: names of both nets; `position`: a point (x, y) that both shapes contain, in mm, y upwards; `layer`: number
    of the copper layer, 1 for the front.
    """

    nets: tuple[str, str]
    position: tuple[float, float]
    layer: int

    def __str__(self) -> str:
        x, y = self.position
        return f"({x:.2f}, {-y:.2f}) mm on copper layer {self.layer}"


@dataclass(frozen=True, eq=False)
class Copper:
    """Connected copper of a board, found from its shapes (polygons) on all layers.

    `trees`: spatial index of the shapes of each layer, front first; `island`: for each shape the number of the set of
    connected shapes to which it belongs, int, shape (shapes,), layer by layer; `first`: index in `island` of the first
    shape of each layer; `contacts`: places where copper of different stated nets touches.
    """

    trees: tuple[Any, ...]
    island: NDArray[np.int64]
    first: tuple[int, ...]
    contacts: tuple[Contact, ...]

    def probe(self, position: tuple[float, float], access: int) -> int | None:
        """Return the number of the set of connected copper shapes at a point, None without copper.

        `position`: x and y in millimetres, y upwards; `access`: number of the layer, from 1 for the front, 0 for any
        layer. A number above the number of layers stands for the back.
        """
        from shapely import Point

        point = Point(*position)
        layers = range(len(self.trees)) if access == 0 else [min(access, len(self.trees)) - 1]
        for layer in layers:
            hits = self.trees[layer].query(point, predicate="intersects")
            if hits.size:
                return int(self.island[self.first[layer] + int(hits[0])])
        return None


def connect_copper(layers: Sequence[list[CopperShape]], plated: Sequence[Hole], unplated: Sequence[Hole]) -> Copper:
    """Return the connected copper of a board.

    `layers`: copper shapes of each layer, front first; `plated`: holes whose plated walls connect all layers;
    `unplated`: holes that only remove copper.
    """
    from shapely import STRtree

    kept = [_drilled(shapes, unplated) for shapes in layers]
    trees = tuple(STRtree([shape.geometry for shape in shapes]) for shapes in kept)
    sizes = [len(shapes) for shapes in kept]
    first = tuple(int(start) for start in np.cumsum([0, *sizes[:-1]]))
    pairs = [_touching(tree) + start for tree, start in zip(trees, first, strict=True)]
    pairs += [_through(trees, first, plated)]
    rows, columns = np.concatenate(pairs, axis=1)
    island = label_components(np.stack([rows, columns], axis=1), sum(sizes))
    shapes = [shape for layer in kept for shape in layer]
    return Copper(trees, island, first, tuple(_contacts(shapes, rows, columns, first)))


def _drilled(shapes: list[CopperShape], holes: Sequence[Hole]) -> list[CopperShape]:
    """Return the shapes of a layer without the copper that holes remove."""
    from shapely import STRtree

    if not (holes and shapes):
        return shapes
    tree = STRtree([shape.geometry for shape in shapes])
    drills = [outline(hole) for hole in holes]
    hit = {int(index) for drill in drills for index in tree.query(drill, predicate="intersects")}
    cut = [shapes[index] for index in sorted(hit)]
    for drill in drills:
        cut = subtract(cut, drill)
    return [shape for index, shape in enumerate(shapes) if index not in hit] + pieces(cut)


def outline(hole: Hole) -> Any:
    """Return the polygon of a drilled hole or slot, in millimetres."""
    from shapely import LineString, Point

    line = Point(hole.start) if hole.start == hole.end else LineString([hole.start, hole.end])
    return line.buffer(hole.diameter / 2, quad_segs=ARC_STEPS)


def _touching(tree: Any) -> NDArray[np.int64]:
    """Return the pairs of touching shapes of a layer as indices into its spatial index, int, shape (2, pairs)."""
    pairs: NDArray[np.int64] = tree.query(tree.geometries, predicate="intersects").astype(np.int64)
    return pairs[:, pairs[0] < pairs[1]]


def _through(trees: Sequence[Any], first: Sequence[int], holes: Sequence[Hole]) -> NDArray[np.int64]:
    """Return the pairs of shapes that plated holes connect, as indices into all shapes, int, shape (2, pairs).

    `trees`: spatial index of the shapes of each layer; `first`: index of the first shape of each layer.
    """
    pairs: list[tuple[int, int]] = []
    for hole in holes:
        drill = outline(hole)
        touched = [
            start + int(index)
            for tree, start in zip(trees, first, strict=True)
            for index in tree.query(drill, predicate="intersects")
        ]
        pairs += [(touched[0], other) for other in touched[1:]]
    return np.array(pairs, dtype=np.int64).reshape(-1, 2).T


def _contacts(
    shapes: Sequence[CopperShape], rows: NDArray[np.int64], columns: NDArray[np.int64], first: Sequence[int]
) -> list[Contact]:
    """Return one place for each pair of different stated nets whose shapes touch; shapes without a net are left out.

    `shapes`: shapes of all layers; `rows`, `columns`: indices of the shapes of each touching pair; `first`: index of
    the first shape of each layer.
    """
    from shapely.ops import nearest_points

    found: dict[tuple[str, str], Contact] = {}
    for a, b in zip(rows.tolist(), columns.tolist(), strict=True):
        nets = (min(shapes[a].net, shapes[b].net), max(shapes[a].net, shapes[b].net))
        if nets[0] == nets[1] or not nets[0] or nets in found:
            continue
        area = shapes[a].geometry.intersection(shapes[b].geometry)
        near = nearest_points(shapes[a].geometry, shapes[b].geometry)[0] if area.is_empty else area
        point = near.representative_point()
        layer = int(np.searchsorted(first, a, side="right"))
        found[nets] = Contact(nets, (point.x, point.y), layer)
    return list(found.values())
