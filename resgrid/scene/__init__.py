"""Scenes: what a person writes, or a map says, about a robot, its surroundings and the chip."""

from resgrid.scene.chip import Chip, Defects, Readout
from resgrid.scene.control import Control
from resgrid.scene.goals import CostArea, GoalCell, GoalJoints, GoalPoint
from resgrid.scene.maps.arrays import MapCells
from resgrid.scene.maps.movingai import Query, read_queries
from resgrid.scene.maps.ros import occupancy_grid
from resgrid.scene.read import parse_scene, read_scene
from resgrid.scene.sampling import sample
from resgrid.scene.scene import Scene

__all__ = [
    "Chip",
    "Control",
    "CostArea",
    "Defects",
    "GoalCell",
    "GoalJoints",
    "GoalPoint",
    "MapCells",
    "Query",
    "Readout",
    "Scene",
    "occupancy_grid",
    "parse_scene",
    "read_queries",
    "read_scene",
    "sample",
]
