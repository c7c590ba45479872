"""Robots: which cells of a configuration space are free, given the obstacles of the workspace."""

from resgrid.robots.point import PointRobot
from resgrid.robots.protocol import Robot, Sampling
from resgrid.robots.shapes import Ball, Box, CellSet, HalfSpace, Polygon, Shape

__all__ = ["Ball", "Box", "CellSet", "HalfSpace", "PointRobot", "Polygon", "Robot", "Sampling", "Shape"]
