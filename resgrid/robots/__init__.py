"""Robots: which cells of a configuration space are free, given the obstacles of the workspace."""

from resgrid.robots.arm import Arm
from resgrid.robots.disc import DiscRobot
from resgrid.robots.point import PointRobot
from resgrid.robots.polygon_robot import PolygonRobot
from resgrid.robots.protocol import GoalCells, Progress, Robot, Sampling
from resgrid.robots.shapes import Ball, Box, CellSet, HalfSpace, Polygon, Shape
from resgrid.robots.solids import to_shapely

__all__ = [
    "Arm",
    "Ball",
    "Box",
    "CellSet",
    "DiscRobot",
    "GoalCells",
    "HalfSpace",
    "PointRobot",
    "Polygon",
    "PolygonRobot",
    "Progress",
    "Robot",
    "Sampling",
    "Shape",
    "to_shapely",
]
