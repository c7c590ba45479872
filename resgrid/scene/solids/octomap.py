"""Reader of OctoMaps (``.bt`` and ``.ot``) as obstacles: occupied voxels, and optionally unknown ones."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from annotated_types import Gt, Lt
from numpy.typing import NDArray

from resgrid.errors import InputError
from resgrid.robots import Voxels
from resgrid.robots.solids import SpacePoint
from resgrid.robots.voxels import merge_boxes
from resgrid.scene.solids.octree import MIDDLE, Octree, read_octree


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
        Treatment of voxels that the map does not contain: free or obstacle.  Space outside the clip box is free.
    occupied : float
        Smallest probability of occupancy at which a voxel is occupied, for ``.ot`` files; ``.bt`` files contain no
        probabilities.
    lower, upper : tuple of (float, float, float), optional
        Corners of the clip box, in metres; voxels whose interior meets the box are kept whole.  By default, those of
        the bounding box of all voxels that the map contains.

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
    tree = read_octree(path, occupied)
    first, last = _clip_range(tree, lower, upper, path)
    cubes = tree.occupied if unknown == "free" else np.concatenate([tree.occupied, tree.unknown])
    cubes = cubes.astype(np.int64)
    boxes = np.stack([np.maximum(cubes[:, :3], first), np.minimum(cubes[:, :3] + cubes[:, 3:], last)], axis=1)
    boxes = boxes[(boxes[:, 0] < boxes[:, 1]).all(axis=1)]
    if not len(boxes):
        where = "" if lower is None and upper is None else " in the clip box"
        raise InputError(f"{path}: no voxel of this OctoMap is an obstacle{where}; leave it out, or check its keys")
    return Voxels((0.0, 0.0, 0.0), tree.resolution, merge_boxes(boxes - MIDDLE))


def _clip_range(
    tree: Octree, lower: SpacePoint | None, upper: SpacePoint | None, path: Path
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first voxel of the clip box and the voxel after its last, each (3,).

    Voxels are counted from the lower corner of the octree's root cube.  `lower`, `upper`: corners (x, y, z) of the box
    in metres, None for a corner of the bounding box of the known leaves; `path`: name of the file, for messages.
    """
    if lower is not None and upper is not None and not all(a < b for a, b in zip(lower, upper, strict=True)):
        raise InputError(f"{path}: the clip box needs lower < upper in every coordinate, got {lower} and {upper}")
    first, last = (corner.astype(np.int64) for corner in tree.bounds)
    root = 2 * MIDDLE
    if lower is not None:
        first = np.clip(np.floor(np.array(lower) / tree.resolution + 1e-9) + MIDDLE, 0, root).astype(np.int64)
    if upper is not None:
        last = np.clip(np.ceil(np.array(upper) / tree.resolution - 1e-9) + MIDDLE, 0, root).astype(np.int64)
    return first, last
