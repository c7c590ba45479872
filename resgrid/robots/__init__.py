"""Robots: which cells of a configuration space are free, given the obstacles of the workspace."""

from resgrid.robots.arm import Arm
from resgrid.robots.base import Robot
from resgrid.robots.cells import Progress, Sampling
from resgrid.robots.geometry import Part, Pose
from resgrid.robots.goals import GoalCells
from resgrid.robots.point import DiscRobot, PointRobot
from resgrid.robots.polygon import PolygonRobot
from resgrid.robots.shapes import Ball, Box, CellSet, HalfSpace, Polygon, Shape, to_shapely

ROBOTS: dict[str, type[Robot]] = {"point": PointRobot, "disc": DiscRobot, "polygon": PolygonRobot, "arm": Arm}
"""Robots by the type that a scene file calls them."""

__all__ = [
    "ROBOTS",
    "Arm",
    "Ball",
    "Box",
    "CellSet",
    "DiscRobot",
    "GoalCells",
    "HalfSpace",
    "Part",
    "PointRobot",
    "Polygon",
    "PolygonRobot",
    "Pose",
    "Progress",
    "Robot",
    "Sampling",
    "Shape",
    "to_shapely",
]
