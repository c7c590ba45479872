"""Scenes of snapshots: the map of a snapshot with the options of the reader of ROS maps and their preparation."""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite
from typing import Any

import numpy as np

from resgrid.errors import InputError, suggestion
from resgrid.scene.maps.arrays import MapCells
from resgrid.scene.maps.formats import map_options
from resgrid.scene.maps.occupancies import OCCUPIED, cells_of_occupancies
from resgrid.scene.maps.preparation import LoadedMap, Preparation
from resgrid.scene.maps.ros import place_of_map
from resgrid.scene.recordings.snapshot import MapSnapshot

MAP_KEYS = (
    "unknown", "lethal", "least_conductivity", "crop", "coarsen", "refine", "inflate_around_unknown", "periodic",
    "headings",
)  # fmt: skip
"""Keys of a ``[map]`` table that apply to the maps of a recording."""


class UnusableMapError(InputError):
    """A map of a recording that cannot be prepared, such as one without a known cell that is cropped to this part."""


def check_map_table(table: Mapping[str, Any]) -> None:
    """Raise InputError for a key of a ``[map]`` table that does not apply to recordings, or for an invalid part."""
    for key in table:
        if key in MAP_KEYS:
            continue
        if key in (*map_options(), "format"):
            raise InputError(f"map.{key} does not apply to the maps of a recording; leave it out")
        raise InputError(
            f"a map has no option {key!r}; {suggestion(key, MAP_KEYS) or 'options: ' + ', '.join(MAP_KEYS)}"
        )
    crop = table.get("crop")
    if crop is None or crop == "known":
        return
    if isinstance(crop, str) or len(crop) != 4 or not all(isfinite(number) for number in crop):
        raise InputError(
            f"map.crop = {crop!r}: give known, or the corners of a box in world coordinates: x0, y0, x1, y1"
        )
    if crop[0] >= crop[2] or crop[1] >= crop[3]:
        raise InputError(f"map.crop = {list(crop)}: the lower corner comes first, and must lie below the upper corner")


def cells_of_snapshot(snapshot: MapSnapshot, table: Mapping[str, Any], extent: float = 0.0) -> MapCells:
    """Return the prepared cells of a snapshot.

    `table`: ``[map]`` table of the scene; `extent`: largest distance from the robot's reference point to a point of the
    robot.  Raise UnusableMapError if the map cannot be cropped as the table demands.
    """
    axes, frame = place_of_map(snapshot.origin, snapshot.resolution, snapshot.occupancy.shape)
    lethal, least = table.get("lethal"), table.get("least_conductivity")
    if least is not None:
        lethal = lethal or OCCUPIED
    cell, unknown = cells_of_occupancies(snapshot.occupancy, table.get("unknown", "obstacle"), lethal)
    costs = None
    if least is not None:
        values = np.clip(snapshot.occupancy.T, 0, 100).astype(np.float64)
        costs = np.ascontiguousarray(
            np.where(values < (lethal or OCCUPIED), least ** (values / (lethal or OCCUPIED)), 1.0)
        )
    preparation = Preparation.of(table, extent)
    try:
        cells = preparation.apply(LoadedMap(MapCells(axes, cell, frame, costs, unknown)), table.get("periodic") or ())
    except InputError as error:
        raise UnusableMapError(str(error)) from None
    return cells.with_table(table)
