"""Scenes: what a person writes, or a map says, about a robot, its surroundings and the chip."""

from resgrid.scene.chip import Chip, Defects, Readout
from resgrid.scene.maps.movingai import Query, read_queries
from resgrid.scene.maps.ros import occupancy_grid
from resgrid.scene.overrides import apply_overrides
from resgrid.scene.quantities import parse_quantity
from resgrid.scene.read import parse_scene, read_scene, scene_schema
from resgrid.scene.sampling import free_volume_lost, sample
from resgrid.scene.scene import CostArea, GoalCell, GoalJoints, GoalPoint, MapCells, Scene

__all__ = [
    "Chip",
    "CostArea",
    "Defects",
    "GoalCell",
    "GoalJoints",
    "GoalPoint",
    "MapCells",
    "Query",
    "Readout",
    "Scene",
    "apply_overrides",
    "free_volume_lost",
    "occupancy_grid",
    "parse_quantity",
    "parse_scene",
    "read_queries",
    "read_scene",
    "sample",
    "scene_schema",
]
