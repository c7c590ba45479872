"""Effects of keep-out masks on the cells of a scene: forbidden cells, obstacles and conductivities; unknown space."""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from resgrid.core.axis import Axis
from resgrid.core.frame import Frame
from resgrid.errors import InputError
from resgrid.robots import CellSet
from resgrid.scene.maps.mask_grids import MaskGrid, read_mask
from resgrid.scene.maps.occupancies import conductivities
from resgrid.scene.scene import Scene
from resgrid.scene.world_coordinates import over_map, unknown_cells


class Keepout(NamedTuple):
    """Effect of a keep-out mask on the cells of the plane.

    `name`: key path of the mask, such as ``mask[0]``; `blocked` (cells along x, cells along y): True for forbidden
    cells; `conductivity`, same shape: upper bound of every cell's conductivity, above 0 and at most 1 (cells without
    costs); `obstacle`: for a mask that keeps the whole robot out, an obstacle in the coordinates of the space, which
    consists of the forbidden cells and of those around the grid that the robot can touch; None for a mask that keeps
    only the robot's reference point out.
    """

    name: str
    blocked: NDArray[np.bool_]
    conductivity: NDArray[np.float64]
    obstacle: CellSet | None


def keepouts_of(scene: Scene) -> list[Keepout]:
    """Return the effect of each keep-out mask of a scene.

    A cell is forbidden if a pixel of at least the mask's `lethal` occupancy overlaps the cell or, with the scene's
    sampling "centre", contains the cell's centre.  As in Nav2's KeepoutFilter, the largest occupancy counts.  Raises
    InputError if the scene has masks, and the configurations of its robot do not begin with a place (x, y).
    """
    require_places(scene)
    effects = []
    for number, mask in enumerate(scene.mask):
        if mask.kind != "keepout":
            continue
        grid, axes = read_mask(mask.file, mask.dialect), scene.axes[:2]
        around = _axes_around(axes, scene, grid) if mask.inflate else axes
        occupancy = grid.largest_in(around, scene.frame, centres=scene.sampling == "centre")
        obstacle = None
        if mask.inflate:
            solid = (*around, *scene.axes[2:]) if scene.robot.turning_length is None else around  # columns, in space
            obstacle = CellSet(solid, over_map(occupancy >= mask.lethal, solid))
        first = [round((axis.lower - outer.lower) / axis.spacing) for axis, outer in zip(axes, around, strict=True)]
        occupancy = occupancy[tuple(slice(low, low + axis.cells) for low, axis in zip(first, axes, strict=True))]
        costs = conductivities(occupancy, mask.least_conductivity, mask.lethal)
        effects.append(Keepout(f"mask[{number}]", occupancy >= mask.lethal, costs, obstacle))
    return effects


def _axes_around(axes: tuple[Axis, ...], scene: Scene, grid: MaskGrid) -> tuple[Axis, ...]:
    """Return the axes x and y, extended by the cells under a mask that the robot can touch from the grid.

    `axes`: axes x and y of the scene; `grid`: pixels of the mask.  Periodic axes are not extended.
    """
    plane = Frame(scene.frame.x, scene.frame.y, scene.frame.yaw)
    corners = np.array(list(product(*((axis.lower, axis.upper) for axis in grid.axes))))
    ends = plane.from_world(grid.frame.to_world(corners))
    extended = []
    for axis, low, high in zip(axes, ends.min(axis=0), ends.max(axis=0), strict=True):
        beyond = np.clip((axis.lower - low, high - axis.upper), 0.0, 0.0 if axis.periodic else scene.robot.extent)
        below, above = np.ceil(beyond / axis.spacing).astype(int).tolist()
        lower, upper = axis.lower - below * axis.spacing, axis.upper + above * axis.spacing
        extended.append(Axis(axis.name, lower, upper, axis.cells + below + above, axis.periodic, axis.unit))
    return tuple(extended)


def require_places(scene: Scene) -> None:
    """Raise InputError if a scene has masks, and the configurations of its robot do not begin with a place (x, y)."""
    if scene.mask and (scene.robot.base is not None or scene.ndim < 2):
        raise InputError(
            f"{scene.source or 'scene'}: mask[0] applies to robots that move in the plane, not to this robot; remove "
            "the masks"
        )


def forbidden_places(scene: Scene, keepouts: list[Keepout]) -> dict[str, NDArray[np.bool_]]:
    """Return the cells that the robot's reference point, but not its body, must avoid, by name of the cause.

    Each value is a mask, shape of the space.  Names: ``"mask[0]"`` and so on for keep-out masks without ``inflate``;
    ``"unknown"`` for unknown space, if ``inflate_around_unknown`` of the map is false.  `keepouts`: effects of the
    scene's keep-out masks.
    """
    parts = {effect.name: over_map(effect.blocked, scene.axes) for effect in keepouts if effect.obstacle is None}
    if scene.map is not None and not scene.map.table.get("inflate_around_unknown", True):
        unknown = unknown_cells(scene.map, scene.axes)
        if unknown is not None:
            parts["unknown"] = unknown
    return parts


def mask_at(scene: Scene, cell: tuple[int, ...]) -> str | None:
    """Return the key path of the first keep-out mask that forbids a cell, such as ``mask[0]``; None if none does.

    `cell`: index of the cell along each axis, of which the first two count.
    """
    axes = tuple(
        Axis(axis.name, axis.lower + index * axis.spacing, axis.lower + (index + 1) * axis.spacing, 1)
        for axis, index in zip(scene.axes[:2], cell[:2], strict=True)
    ) if scene.mask else ()  # fmt: skip
    frame = Frame(scene.frame.x, scene.frame.y, scene.frame.yaw)
    for number, mask in enumerate(scene.mask):
        if mask.kind == "keepout":
            grid = read_mask(mask.file, mask.dialect)
            if grid.largest_in(axes, frame, centres=scene.sampling == "centre")[0, 0] >= mask.lethal:
                return f"mask[{number}]"
    return None
