"""Reader of OctoMaps (``.bt`` and ``.ot``): occupied voxels, and optionally unknown ones, as obstacles.

The formats are those of OctoMap 1.4 and later (A. Hornung et al., Autonomous Robots 34 (2013) 189).  A file is read
here and not by the OctoMap library, because the library returns a part of the tree for an ``.ot`` file that is cut
short.
"""

from __future__ import annotations

import os
from math import log
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import numpy as np
from annotated_types import Gt, Lt
from numpy.typing import NDArray

from resgrid._internal.files import read_bytes
from resgrid.core.axis import LARGEST
from resgrid.errors import InputError
from resgrid.robots import Voxels
from resgrid.robots.solids import SpacePoint
from resgrid.robots.voxels import merge_boxes

DEPTH = 16
"""Number of levels of an OctoMap below its root, whose cube has ``2**16`` voxels along every axis."""

_MIDDLE = 1 << (DEPTH - 1)
"""Index, in voxels from the corner of the root's cube, of the origin."""

_BINARY, _FULL = b"# Octomap OcTree binary file", b"# Octomap OcTree file"
"""First lines of ``.bt`` and ``.ot`` files."""

_NODE_TYPES = {
    "OcTree": np.dtype([("value", "<f4"), ("children", "u1")]),
    "ColorOcTree": np.dtype([("value", "<f4"), ("colour", "u1", (3,)), ("children", "u1")]),
}
"""Types of a node in ``.ot`` files by the header's ``id``: log-odds of occupancy, and a bit for every child."""

_FREE, _OCCUPIED, _INNER = 1, 2, 3
"""Codes of a child in ``.bt`` files; 0 is unknown."""


class Leaves(NamedTuple):
    """Leaves of an octree as cubes, each shape (n, 4): lower corner and width, in voxels from the root's corner."""

    free: NDArray[np.int64]
    occupied: NDArray[np.int64]
    unknown: NDArray[np.int64]


def read_octomap(
    file: str | os.PathLike[str],
    *,
    unknown: Literal["free", "obstacle"] = "free",
    occupied: Annotated[float, Gt(0), Lt(1)] = 0.5,
    lower: SpacePoint | None = None,
    upper: SpacePoint | None = None,
) -> Voxels:
    """Read an OctoMap (``.bt`` or ``.ot``) as an obstacle.

    Parameters
    ----------
    file : path-like
        The file.
    unknown : {"free", "obstacle"}
        Whether voxels that the map does not contain are obstacles.  Space outside the clip box is free.
    occupied : float
        Probability from which a voxel is occupied, for ``.ot`` files; ``.bt`` files contain no probabilities.
    lower, upper : tuple of (float, float, float), optional
        Corners of the clip box, in metres; voxels whose interior meets the box are kept whole.  By default, the
        bounding box of all voxels that the map contains.

    Returns
    -------
    Voxels
        The obstacle voxels, merged into few boxes.

    Raises
    ------
    InputError
        If the file is missing, damaged or of an unknown kind, or no voxel is an obstacle.

    Examples
    --------
    >>> import octomap
    >>> tree = octomap.OcTree(0.1)
    >>> for x in (0.05, 0.15, 0.25):
    ...     node = tree.updateNode(np.array([x, 0.05, 0.05]), True)
    >>> saved = tree.writeBinary(b"row.bt")
    >>> rg.maps.read_octomap("row.bt")
    <Voxels: 3 of width 0.1 in 1 box>
    """
    path = Path(file)
    leaves, resolution = _read(path, log(occupied / (1 - occupied)))
    known = np.concatenate([leaves.free, leaves.occupied])
    if not len(known):
        raise InputError(f"{path}: this OctoMap is empty; check how it was made")
    first, last = _clip_range(known, resolution, lower, upper, path)
    cubes = leaves.occupied if unknown == "free" else np.concatenate([leaves.occupied, leaves.unknown])
    boxes = np.stack([np.maximum(cubes[:, :3], first), np.minimum(cubes[:, :3] + cubes[:, 3:], last)], axis=1)
    boxes = boxes[(boxes[:, 0] < boxes[:, 1]).all(axis=1)]
    if not len(boxes):
        where = "" if lower is None and upper is None else " in the clip box"
        raise InputError(f"{path}: no voxel of this OctoMap is an obstacle{where}; leave it out, or check its keys")
    return Voxels((0.0, 0.0, 0.0), resolution, merge_boxes(boxes - _MIDDLE))


def _clip_range(
    known: NDArray[np.int64], resolution: float, lower: SpacePoint | None, upper: SpacePoint | None, path: Path
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first voxel of the clip box and the voxel after its last (3,), in voxels from the root's corner.

    `known` (n, 4): lower corner and width of all known leaves, in voxels; `resolution`: width of a voxel in metres;
    `lower`, `upper`: corners (x, y, z) of the box in metres, or None for those of the known leaves; `path`: for
    messages.
    """
    if lower is not None and upper is not None and not all(a < b for a, b in zip(lower, upper, strict=True)):
        raise InputError(f"{path}: the clip box needs lower < upper in every coordinate, got {lower} and {upper}")
    first, last = known[:, :3].min(axis=0), (known[:, :3] + known[:, 3:]).max(axis=0)
    root = 2 * _MIDDLE
    if lower is not None:
        first = np.clip(np.floor(np.array(lower) / resolution + 1e-9) + _MIDDLE, 0, root).astype(np.int64)
    if upper is not None:
        last = np.clip(np.ceil(np.array(upper) / resolution - 1e-9) + _MIDDLE, 0, root).astype(np.int64)
    return first, last


def _read(path: Path, threshold: float) -> tuple[Leaves, float]:
    """Return the leaves of an OctoMap and the width of a voxel in metres.

    `threshold`: log-odds from which a leaf of an ``.ot`` file is occupied.
    """
    data = read_bytes(path)
    is_binary = data.startswith(_BINARY)
    if not is_binary and not data.startswith(_FULL):
        raise InputError(
            f"{path}: this is not an OctoMap of version 1.4 or later; give a .bt or .ot file, or convert older files "
            "with convert_octree"
        )
    kind, size, resolution, body = _header(data, path)
    if is_binary:
        return _binary_leaves(body, size, path), resolution
    if kind not in _NODE_TYPES:
        raise InputError(
            f"{path}: trees of the kind {kind!r} are unknown; save it as a .bt file, or as one of "
            f"{', '.join(_NODE_TYPES)}"
        )
    return _full_leaves(body, _NODE_TYPES[kind], size, threshold, path), resolution


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


def _binary_leaves(body: bytes, size: int, path: Path) -> Leaves:
    """Return the leaves of a ``.bt`` file: two bits for every child of every inner node, in depth-first order.

    `body`: bytes after the header; `size`: number of nodes according to the header.
    """
    words = np.frombuffer(body[: len(body) // 2 * 2], "<u2")
    stream = words.tolist()
    inner_children = {
        word: [child for child in reversed(range(8)) if word >> 2 * child & 3 == _INNER] for word in set(stream)
    }
    corners: list[tuple[int, int, int, int]] = []
    stack = [(0, 0, 0, _MIDDLE)] if size else []
    while stack:
        x, y, z, half = node = stack.pop()
        if len(corners) == len(stream) or not half:
            raise _damaged(path)
        children = inner_children[stream[len(corners)]]
        corners.append(node)
        for child in children:
            stack.append((x + half * (child & 1), y + half * (child >> 1 & 1), z + half * (child >> 2), half >> 1))
    inner = np.array(corners, dtype=np.int64).reshape(-1, 4)
    codes = words[: len(inner), np.newaxis] >> 2 * np.arange(8, dtype=np.uint16) & 3
    if size and size != 1 + int(np.count_nonzero(codes)):
        raise _damaged(path)
    return Leaves(*(_child_cubes(inner, codes == code) for code in (_FREE, _OCCUPIED, 0)))


def _full_leaves(body: bytes, dtype: np.dtype[np.void], size: int, threshold: float, path: Path) -> Leaves:
    """Return the leaves of an ``.ot`` file: value and bits of existing children of every node, in depth-first order.

    `body`: bytes after the header; `dtype`: type of a node; `size`: number of nodes according to the header;
    `threshold`: log-odds from which a leaf is occupied.
    """
    if size < 0 or len(body) < size * dtype.itemsize:
        raise _damaged(path)
    nodes = np.frombuffer(body[: size * dtype.itemsize], dtype)
    present = nodes["children"].tolist()
    children_of = [[child for child in reversed(range(8)) if bits >> child & 1] for bits in range(256)]
    corners: list[tuple[int, int, int, int]] = []
    stack = [(0, 0, 0, 2 * _MIDDLE)] if size else []
    while stack:
        x, y, z, width = node = stack.pop()
        if len(corners) == size or not width:
            raise _damaged(path)
        children = children_of[present[len(corners)]]
        corners.append(node)
        half = width >> 1
        for child in children:
            stack.append((x + half * (child & 1), y + half * (child >> 1 & 1), z + half * (child >> 2), half))
    if len(corners) != size:
        raise _damaged(path)
    cubes = np.array(corners, dtype=np.int64).reshape(-1, 4)
    is_leaf = nodes["children"] == 0
    if not np.isfinite(nodes["value"][is_leaf]).all():
        raise _damaged(path)
    is_occupied = nodes["value"] >= threshold
    inner = cubes[~is_leaf] // [1, 1, 1, 2]
    bits = nodes["children"][~is_leaf, np.newaxis] >> np.arange(8, dtype=np.uint8) & 1
    return Leaves(cubes[is_leaf & ~is_occupied], cubes[is_leaf & is_occupied], _child_cubes(inner, bits == 0))


def _child_cubes(inner: NDArray[np.int64], which: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the cubes (n, 4) of marked children of inner nodes.

    `inner` (m, 4): lower corner of every inner node and half its width; `which` (m, 8): marked children.
    """
    node, child = np.nonzero(which)
    cubes = inner[node]
    cubes[:, :3] += cubes[:, 3:] * (child[:, np.newaxis] >> np.arange(3) & 1)
    return cubes


def _damaged(path: Path) -> InputError:
    return InputError(f"{path}: this OctoMap is cut short or damaged: its nodes do not form a tree; copy it again")
