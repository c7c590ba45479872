"""Reader of the triangles of COLLADA files (DAE); ignores materials, and rejects geometry that it cannot read.

Other readers of COLLADA drop geometry silently when a material or texture is missing.  A dropped triangle is a missed
collision, so that this reader raises InputError for everything that it cannot read.
Source: COLLADA 1.4.1, chapter 5 (geometry, node, source).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import TypeVar
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from resgrid.errors import InputError

Number = TypeVar("Number", np.float64, np.int64)
Triangles = tuple[NDArray[np.float64], NDArray[np.int32]]

_MAX_DEPTH = 200
"""Maximum depth of nested nodes; deeper ones are taken for a cycle of references, and raise InputError."""

_DIGITS = 9
"""Maximum number of digits of the attributes offset, stride and count; longer numbers raise InputError."""

_IGNORED = ("lines", "linestrips", "points")
"""Names of primitive elements without area, which are skipped."""


class _Document:
    """A COLLADA document: its elements by their identifier, and the name of the file in messages.

    `root`: root element, with names without namespace; `name`: name of the file; `by_id`: for every value of the
    attribute ``id``, the list of elements with this value.
    """

    def __init__(self, root: Element, name: str) -> None:
        self.root, self.name = root, name
        self.by_id: dict[str, list[Element]] = {}
        for each in root.iter():
            self.by_id.setdefault(each.get("id", ""), []).append(each)

    def error(self, problem: str) -> InputError:
        """Return the InputError that names the file and states `problem`, a phrase."""
        return InputError(f"{self.name}: the mesh cannot be read as COLLADA ({problem}); export it again")

    def target(self, reference: str | None, mesh: Element | None = None) -> Element:
        """Return the element that a reference such as ``"#mesh"`` names; raise InputError unless there is exactly one.

        `mesh`: element in which the identifier is sought first, because some exporters repeat the identifiers of
        sources in every mesh.
        """
        name = (reference or "").removeprefix("#")
        own = [each for each in (mesh if mesh is not None else ()) if each.get("id") == name]
        found = own or (self.by_id.get(name, []) if name else [])
        if not found:
            raise self.error(f"it refers to {reference!r}, which does not exist")
        if len(found) > 1:
            raise self.error(f"it refers to {reference!r}, which exists {len(found)} times")
        return found[0]

    def numbers(self, element: Element | None, kind: type[Number]) -> NDArray[Number]:
        """Return the numbers (n,) in the text of an element; empty for None; raise InputError for other text.

        `kind`: numpy data type of the numbers.
        """
        try:
            return np.array((element.text or "").split() if element is not None else [], dtype=kind)
        except (ValueError, OverflowError):
            raise self.error(f"<{element.tag if element is not None else ''}> holds text that is no number") from None

    def whole(self, element: Element, name: str, default: int) -> int:
        """Return an attribute of an element as an integer of at least 0; raise InputError for other text.

        `name`: name of the attribute; `default`: value if it is missing.
        """
        text = element.get(name, str(default)).strip()
        if not text.isdecimal() or len(text) > _DIGITS:
            raise self.error(f"<{element.tag} {name}={text!r}> is not a whole number")
        return int(text)


def read_collada(data: bytes, name: str) -> Triangles:
    """Return vertices (v, 3) in metres and triangles (t, 3), indices of vertices, of the bytes of a COLLADA file.

    The unit of the file is applied; the up axis is ignored, as in ROS.

    Parameters
    ----------
    data : bytes
        Content of the file.
    name : str
        Name of the file in messages.

    Raises
    ------
    InputError
        If the file is not COLLADA, refers to missing geometry, or contains splines or skins.
    """
    try:
        root = ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise InputError(f"{name}: the mesh is not valid XML ({error}); export it again") from None
    for element in root.iter():  # names without the namespace
        if isinstance(element.tag, str):
            element.tag = element.tag.rpartition("}")[2]
    document = _Document(root, name)
    scene = root.find("scene/instance_visual_scene")
    if root.tag != "COLLADA" or scene is None:
        raise document.error("it has no scene")
    unit = root.find("asset/unit")
    try:
        scale = float(unit.get("meter", "1")) if unit is not None else 1.0
    except ValueError:
        scale = math.nan
    if not 0 < scale < math.inf:
        raise document.error("its unit is not a positive number of metres")
    points: list[NDArray[np.float64]] = [np.empty((0, 3))]
    triangles: list[NDArray[np.int32]] = [np.empty((0, 3), dtype=np.int32)]
    for geometry, pose in _placed(document, document.target(scene.get("url")), np.diag([scale, scale, scale, 1.0]), 0):
        for corners, faces in _primitives(document, geometry):
            triangles.append(faces + np.int32(sum(map(len, points))))
            points.append(corners @ pose[:3, :3].T + pose[:3, 3])
    return np.concatenate(points), np.concatenate(triangles)


def _placed(
    document: _Document, parent: Element, pose: NDArray[np.float64], depth: int
) -> Iterator[tuple[Element, NDArray[np.float64]]]:
    """Yield every instance of a geometry below a node or scene, with its transformation (4, 4) to the root's frame.

    `parent`: node or scene; `pose` (4, 4): transformation of `parent` to the root's frame; `depth`: number of nodes
    above, limited by `_MAX_DEPTH`.
    """
    if depth > _MAX_DEPTH:
        raise document.error("its nodes refer to each other")
    for child in parent:
        if child.tag == "node":
            yield from _placed(document, child, pose @ _transformation(document, child), depth + 1)
        elif child.tag == "instance_node":
            node = document.target(child.get("url"))
            yield from _placed(document, node, pose @ _transformation(document, node), depth + 1)
        elif child.tag == "instance_geometry":
            yield document.target(child.get("url")), pose
        elif child.tag == "instance_controller":
            raise document.error("it contains a skin or morph; bake the shape")


def _transformation(document: _Document, node: Element) -> NDArray[np.float64]:
    """Return the product (4, 4) of the transformations of a node, the first one in the file leftmost."""
    product = np.eye(4)
    for child in node:
        if child.tag in _TRANSFORMATIONS:
            count, matrix = _TRANSFORMATIONS[child.tag]
            values = document.numbers(child, np.float64)
            if len(values) != count:
                raise document.error(f"<{child.tag}> has {len(values)} numbers instead of {count}")
            product = product @ matrix(values)
        elif child.tag in ("skew", "lookat"):
            raise document.error(f"<{child.tag}> is not supported")
    return product


def _translation(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the translation (4, 4) by a vector (3,)."""
    matrix = np.eye(4)
    matrix[:3, 3] = values
    return matrix


def _rotation(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation (4, 4) about an axis through the origin.

    `values` (4,): axis, not necessarily of length 1, and angle in degrees.
    """
    matrix, angle = np.eye(4), math.radians(values[3])
    x, y, z = values[:3] / (np.linalg.norm(values[:3]) or 1.0)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    matrix[:3, :3] += math.sin(angle) * cross + (1 - math.cos(angle)) * (cross @ cross)
    return matrix


_TRANSFORMATIONS: dict[str, tuple[int, Callable[[NDArray[np.float64]], NDArray[np.float64]]]] = {
    "matrix": (16, lambda values: values.reshape(4, 4)),
    "translate": (3, _translation),
    "rotate": (4, _rotation),
    "scale": (3, lambda values: np.diag([*values, 1.0])),
}
"""For every name of a transformation element: number of values, and function from the values to the matrix (4, 4)."""


def _primitives(document: _Document, geometry: Element) -> Iterator[Triangles]:
    """Yield the vertices (v, 3), in the file's unit, and triangles (t, 3) of every primitive of a geometry.

    Triangles are indices of vertices.  Raise InputError for splines and other elements that are not polygons.
    """
    mesh = geometry.find("mesh")
    if mesh is None:
        raise document.error(f"geometry {geometry.get('id')!r} is not a mesh")
    for primitive in mesh:
        if primitive.tag in ("triangles", "polylist", "polygons", "trifans", "tristrips"):
            stride, offset, source = _vertex_input(document, mesh, primitive)
            points = _source(document, source)
            faces = _faces(document, primitive, stride, offset)
            if faces.size and (faces.min() < 0 or faces.max() >= len(points)):
                raise document.error("a triangle refers to a vertex that does not exist")
            yield points, faces.astype(np.int32)
        elif primitive.tag not in (*_IGNORED, "source", "vertices", "extra"):
            raise document.error(f"<{primitive.tag}> is not supported")


def _vertex_input(document: _Document, mesh: Element, primitive: Element) -> tuple[int, int, Element]:
    """Return the number of indices per corner, the place of the vertex index among them, and the source of positions.

    The place counts from 0. `mesh`: element that contains the primitive and its sources; `primitive`: element with the
    corners, such as ``<triangles>``. Raises InputError for a primitive without positions.
    """
    inputs = primitive.findall("input")
    stride = max((document.whole(each, "offset", 0) for each in inputs), default=0) + 1
    for each in inputs:
        if each.get("semantic") == "VERTEX":
            for inner in document.target(each.get("source"), mesh).findall("input"):
                if inner.get("semantic") == "POSITION":
                    return stride, document.whole(each, "offset", 0), document.target(inner.get("source"), mesh)
    raise document.error(f"<{primitive.tag}> has no vertices")


def _source(document: _Document, source: Element) -> NDArray[np.float64]:
    """Return the positions (v, 3) in the array of a source, in the unit of the file."""
    accessor = source.find("technique_common/accessor")
    values = document.numbers(source.find("float_array"), np.float64)
    stride = document.whole(accessor, "stride", 1) if accessor is not None else 3
    start = document.whole(accessor, "offset", 0) if accessor is not None else 0
    count = document.whole(accessor, "count", 0) if accessor is not None else len(values) // 3
    if stride < 3 or start + count * stride > len(values):
        raise document.error(f"source {source.get('id')!r} has fewer numbers than its accessor")
    return values[start : start + count * stride].reshape(count, stride)[:, :3]


def _faces(document: _Document, primitive: Element, stride: int, offset: int) -> NDArray[np.int64]:
    """Return the triangles (t, 3) of a primitive, indices of positions; polygons become fans around their first corner.

    `stride`: number of indices per corner; `offset`: place of the vertex index among them, from 0.
    """
    if primitive.find("ph") is not None:
        raise document.error("a polygon has holes")
    rows = [document.numbers(each, np.int64) for each in primitive.findall("p")]
    if any(len(row) % stride for row in rows):
        raise document.error(f"<{primitive.tag}> ends within a corner")
    corners = [row.reshape(-1, stride)[:, offset] for row in rows]
    if primitive.tag == "triangles":
        if any(len(each) % 3 for each in corners):
            raise document.error("<triangles> ends within a triangle")
        return np.concatenate([np.empty(0, np.int64), *corners]).reshape(-1, 3)
    if primitive.tag == "tristrips":
        return _rows([np.column_stack([each[:-2], each[1:-1], each[2:]]) for each in corners])
    if primitive.tag == "polylist":
        counts = document.numbers(primitive.find("vcount"), np.int64)
        indices = np.concatenate([np.empty(0, np.int64), *corners])
        if counts.min(initial=0) < 0 or counts.sum() != len(indices):
            raise document.error("<polylist> has a wrong number of corners")
        return _fans(indices, counts)
    counts = np.array([len(each) for each in corners], dtype=np.int64)  # polygons and fans: one row each
    return _fans(np.concatenate([np.empty(0, np.int64), *corners]), counts)


def _fans(indices: NDArray[np.int64], counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the triangles (t, 3) of polygons, as fans around their first corners.

    `indices`: vertex indices of the corners of all polygons, one polygon after the other; `counts` (polygons,): number
    of corners of every polygon.
    """
    first = np.cumsum(counts) - counts
    parts = np.maximum(counts - 2, 0)
    within = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
    start = np.repeat(first, parts)
    return _rows([np.column_stack([indices[start], indices[start + within + 1], indices[start + within + 2]])])


def _rows(parts: list[NDArray[np.int64]]) -> NDArray[np.int64]:
    """Return the concatenation (t, 3) of arrays of triangles, shape (0, 3) for an empty list."""
    return np.concatenate([np.empty((0, 3), np.int64), *parts])
