"""Cells of the map of a snapshot of a recording, prepared as a ``[map]`` table demands, and checks of this table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from resgrid._internal.numbers import is_number
from resgrid.errors import InputError, suggestion
from resgrid.scene.maps.arrays import MapCells
from resgrid.scene.maps.formats import map_options
from resgrid.scene.maps.occupancies import OCCUPIED_FROM, cells_of_occupancies, conductivities
from resgrid.scene.maps.preparation import LoadedMap, Preparation, check_corners
from resgrid.scene.maps.ros import place_of_map
from resgrid.scene.recordings.snapshot import MapSnapshot

MAP_KEYS = (
    "unknown", "lethal", "least_conductivity", "crop", "coarsen", "refine", "inflate_around_unknown", "periodic",
    "headings",
)  # fmt: skip
"""Keys of a ``[map]`` table that apply to the maps of a recording."""


class UnusableMapError(InputError):
    """A map of a recording cannot be prepared, for example ``crop = "known"`` for a map without a known cell."""


def check_map_table(table: Mapping[str, Any]) -> None:
    """Raise InputError for a key of a ``[map]`` table that does not apply to recordings, or for an invalid `crop`."""
    for key in table:
        if key in MAP_KEYS:
            continue
        if key in (*map_options(), "format"):
            raise InputError(f"map.{key} does not apply to the maps of a recording; leave it out")
        raise InputError(
            f"a map has no option {key!r}; {suggestion(key, MAP_KEYS) or 'options: ' + ', '.join(MAP_KEYS)}"
        )
    crop = table.get("crop")
    if crop is None or (isinstance(crop, str) and crop == "known"):
        return
    if isinstance(crop, str) or not isinstance(crop, Sequence) or len(crop) != 4 or not all(map(is_number, crop)):
        raise InputError(
            f"map.crop = {crop!r}: give known, or the corners of a box in world coordinates: x0, y0, x1, y1"
        )
    check_corners(crop)


def cells_of_snapshot(snapshot: MapSnapshot, table: Mapping[str, Any], extent: float = 0.0) -> MapCells:
    """Return the cells of a snapshot after cropping and after joining or dividing cells, as a ``[map]`` table demands.

    `table`: values of the ``[map]`` table by key; `extent`: largest distance from the robot's reference point to a
    point of the robot, in metres.  Obstacles outside a cropped map that the robot can touch from inside are kept in
    `MapCells.surroundings`; the grid itself gets no margin.  Raises UnusableMapError if the cells cannot be cropped,
    joined or divided as the table demands.
    """
    axes, frame = place_of_map(snapshot.origin, snapshot.resolution, snapshot.occupancy.shape)
    lethal, least = table.get("lethal"), table.get("least_conductivity")
    costs = None
    if least is not None:
        lethal = OCCUPIED_FROM if lethal is None else lethal
        costs = conductivities(snapshot.occupancy.T, least, lethal)
    cell, unknown = cells_of_occupancies(snapshot.occupancy, table.get("unknown", "obstacle"), lethal)
    preparation = Preparation.of(table, extent)
    try:
        cells = preparation.apply(LoadedMap(MapCells(axes, cell, frame, costs, unknown)), table.get("periodic") or ())
    except InputError as error:
        raise UnusableMapError(str(error)) from None
    return cells.with_table(table)
