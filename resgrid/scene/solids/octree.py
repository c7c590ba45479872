"""Parser of OctoMap files (``.bt`` and ``.ot``): the leaves of an octree as cubes.

The formats are those of OctoMap 1.4 and later (A. Hornung et al., Autonomous Robots 34 (2013) 189).  A file is read
here and not by the OctoMap library, because the library returns a part of the tree for an ``.ot`` file that is cut
short.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import log
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from resgrid._internal.files import read_bytes
from resgrid._internal.memory import require_memory
from resgrid.core.axis import LARGEST
from resgrid.errors import InputError

DEPTH = 16
"""Number of levels of an OctoMap below its root; the root's cube has ``2**16`` voxels along every axis."""

MIDDLE = 1 << (DEPTH - 1)
"""Index of the origin along every axis, in voxels from the lower corner of the root's cube."""

BINARY, FULL = b"# Octomap OcTree binary file", b"# Octomap OcTree file"
"""First lines of ``.bt`` and ``.ot`` files."""

_NODE_TYPES = {
    "OcTree": np.dtype([("value", "<f4"), ("children", "u1")]),
    "ColorOcTree": np.dtype([("value", "<f4"), ("colour", "u1", (3,)), ("children", "u1")]),
}
"""Types of a node in ``.ot`` files by the ``id`` in the header.

`value`: natural logarithm of the odds of occupancy; `children`: one bit for each of the eight possible children.
"""

_BYTES_PER_NODE = (140.0, 320.0)
"""Estimated memory in bytes per node of a ``.bt`` and of an ``.ot`` file while its leaves are computed."""

_FREE, _OCCUPIED, _INNER = 1, 2, 3
"""Codes of a child in ``.bt`` files: free leaf, occupied leaf, and inner node; 0 is unknown."""

_NO_CUBES = np.empty((0, 4), dtype=np.int32)
"""Array (0, 4) without cubes."""


@dataclass(frozen=True, eq=False)
class Octree:
    """Leaves of an octree as cubes.

    A cube is the lower corner (x, y, z) and the width, in voxels from the lower corner of the root's cube.
    `resolution`: width of a voxel in metres; `free` (n, 4), `occupied` (m, 4): known leaves; `inner` (k, 4): lower
    corner of every inner node and half its width; `missing` (k, 8): mask of the children of each inner node that do not
    exist. Bits 0, 1 and 2 of a child's index are 1 in the upper half along x, y and z.
    """

    resolution: float
    free: NDArray[np.int32]
    occupied: NDArray[np.int32]
    inner: NDArray[np.int32]
    missing: NDArray[np.bool_]

    @cached_property
    def unknown(self) -> NDArray[np.int32]:
        """Cubes (l, 4) of the children that do not exist, which are unknown space inside the root's cube.

        A cube is the lower corner and the width, in voxels from the lower corner of the root's cube.
        """
        return _child_cubes(self.inner, self.missing)

    @property
    def bounds(self) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """First voxel of the bounding box of all known leaves, and the voxel after its last one, each (3,).

        Voxels are counted from the lower corner of the root's cube.
        """
        known = [cubes for cubes in (self.free, self.occupied) if len(cubes)]
        first = np.min([cubes[:, :3].min(axis=0) for cubes in known], axis=0)
        return first, np.max([(cubes[:, :3] + cubes[:, 3:]).max(axis=0) for cubes in known], axis=0)


def read_octree(path: Path, occupied: float) -> Octree:
    """Return the leaves of an OctoMap; raise InputError for a file that is missing, damaged, or without leaves.

    `occupied`: smallest probability of occupancy at which a leaf of an ``.ot`` file is occupied.
    """
    data = read_bytes(path)
    is_binary = data.startswith(BINARY)
    if not is_binary and not data.startswith(FULL):
        raise InputError(
            f"{path}: this is not an OctoMap of version 1.4 or later; give a .bt or .ot file, or convert older files "
            "with convert_octree"
        )
    kind, size, resolution, body = _header(data, path)
    most, memory = (4 * len(body), _BYTES_PER_NODE[0]) if is_binary else (len(body) // 5, _BYTES_PER_NODE[1])
    require_memory(min(size, most) * memory, f"{path}: {min(size, most)} nodes", "save the tree at a lower resolution")
    if is_binary:
        tree = _binary_leaves(body, size, resolution, path)
    elif kind in _NODE_TYPES:
        tree = _full_leaves(body, _NODE_TYPES[kind], size, (log(occupied / (1 - occupied)), resolution), path)
    else:
        raise InputError(
            f"{path}: trees of the kind {kind!r} are unknown; save it as a .bt file, or as one of "
            f"{', '.join(_NODE_TYPES)}"
        )
    if not len(tree.free) and not len(tree.occupied):
        raise InputError(f"{path}: this OctoMap is empty; check how it was made")
    return tree


def _header(data: bytes, path: Path) -> tuple[str, int, float, bytes]:
    """Return the kind of tree, number of nodes, width of a voxel in metres, and the bytes after the header.

    The kind is the header's ``id``, such as ``OcTree``.  `data`: content of the file; `path`: name of the file, for
    messages.
    """
    head, mark, body = data.partition(b"\ndata\n")
    lines = [line.split(maxsplit=1) for line in head.decode("latin-1").split("\n") if not line.startswith("#")]
    entries = {words[0]: words[1].strip() for words in lines if len(words) == 2}
    try:
        kind, size, resolution = entries["id"], int(entries["size"]), float(entries["res"])
    except (KeyError, ValueError):
        mark = b""
    if not mark:
        raise InputError(f"{path}: the header of this OctoMap is incomplete or damaged; save it again")
    if not 1 / LARGEST < resolution < LARGEST:
        raise InputError(f"{path}: the resolution of this OctoMap is {resolution}; it must be a length above 0")
    return kind, size, resolution, body


def _binary_leaves(body: bytes, size: int, resolution: float, path: Path) -> Octree:
    """Return the leaves of a ``.bt`` file: two bits for every child of every inner node, in depth-first order.

    `body`: bytes after the header; `size`: number of nodes according to the header; `resolution`: width of a voxel in
    metres; `path`: name of the file, for messages.
    """
    words = np.frombuffer(body[: len(body) // 2 * 2], "<u2")
    stream = words.tolist()
    inner_children = {
        word: [child for child in reversed(range(8)) if word >> 2 * child & 3 == _INNER] for word in set(stream)
    }
    inner = _halved(_cubes_of_nodes(stream, inner_children, 2, path) if size else _NO_CUBES)
    codes = words[: len(inner), np.newaxis] >> 2 * np.arange(8, dtype=np.uint16) & 3
    if size and size != 1 + int(np.count_nonzero(codes)):
        raise _damaged(path)
    free, occupied = (_child_cubes(inner, codes == code) for code in (_FREE, _OCCUPIED))
    return Octree(resolution, free, occupied, inner, codes == 0)


def _full_leaves(body: bytes, dtype: np.dtype[np.void], size: int, scale: tuple[float, float], path: Path) -> Octree:
    """Return the leaves of an ``.ot`` file, which holds all nodes in depth-first order.

    `body`: bytes after the header; `dtype`: type of a node, with its value and a bit for each existing child; `size`:
    number of nodes according to the header; `scale`: smallest natural logarithm of the odds of an occupied leaf, and
    width of a voxel in metres; `path`: name of the file, for messages.
    """
    threshold, resolution = scale
    if size < 0 or len(body) < size * dtype.itemsize:
        raise _damaged(path)
    nodes = np.frombuffer(body[: size * dtype.itemsize], dtype)
    present = nodes["children"].tolist()
    children_of = {bits: [child for child in reversed(range(8)) if bits >> child & 1] for bits in range(256)}
    cubes = _cubes_of_nodes(present, children_of, 1, path) if size else _NO_CUBES
    if len(cubes) != size:
        raise _damaged(path)
    is_leaf = nodes["children"] == 0
    if not np.isfinite(nodes["value"][is_leaf]).all():
        raise _damaged(path)
    is_occupied = nodes["value"] >= threshold
    inner = _halved(cubes[~is_leaf])
    bits = nodes["children"][~is_leaf, np.newaxis] >> np.arange(8, dtype=np.uint8) & 1
    return Octree(resolution, cubes[is_leaf & ~is_occupied], cubes[is_leaf & is_occupied], inner, bits == 0)


def _cubes_of_nodes(codes: list[int], children: dict[int, list[int]], least: int, path: Path) -> NDArray[np.int32]:
    """Return the cubes (n, 4) of the nodes of a tree in depth-first order: lower corner and width in voxels.

    `codes`: code of every node in this order; codes after the last node are ignored; `children`: for each code, indices
    (0 to 7) of the children of a node with this code, in descending order; `least`: smallest allowed width of a node,
    in voxels; `path`: name of the file, for messages.  Raises InputError if the nodes do not form a tree.
    """
    cubes: list[tuple[int, int, int, int]] = []
    stack = [(0, 0, 0, 2 * MIDDLE)]
    while stack:
        x, y, z, width = node = stack.pop()
        if len(cubes) == len(codes) or width < least:
            raise _damaged(path)
        half = width >> 1
        for child in children[codes[len(cubes)]]:
            stack.append((x + half * (child & 1), y + half * (child >> 1 & 1), z + half * (child >> 2), half))
        cubes.append(node)
    return np.array(cubes, dtype=np.int32)


def _halved(cubes: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return cubes (n, 4), each a lower corner and a width, with the same corners and half the widths."""
    return cubes // np.array([1, 1, 1, 2], dtype=np.int32)


def _child_cubes(inner: NDArray[np.int32], which: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Return the cubes (n, 4) of marked children of inner nodes.

    `inner` (m, 4): lower corner of every inner node and half its width; `which` (m, 8): mask of children, of whose
    index the bits 0, 1 and 2 are 1 in the upper half along x, y and z.
    """
    node, child = np.nonzero(which)
    cubes = inner[node]
    cubes[:, :3] += cubes[:, 3:] * (child[:, np.newaxis].astype(np.int32) >> np.arange(3, dtype=np.int32) & 1)
    return cubes


def _damaged(path: Path) -> InputError:
    return InputError(f"{path}: this OctoMap is cut short or damaged: its nodes do not form a tree; copy it again")
