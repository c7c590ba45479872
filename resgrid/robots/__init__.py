"""Robots: geometry, kinematics, and the free cells of their configuration spaces among workspace obstacles.

Robots may import `core` and packages below it; they do not depend on scenes or circuits.
"""

from resgrid.robots.arm import Arm as Arm
from resgrid.robots.base import Robot as Robot
from resgrid.robots.cells import GoalCells as GoalCells, Progress as Progress, Sampling as Sampling
from resgrid.robots.geometry import Pose as Pose, RigidPart as RigidPart
from resgrid.robots.mesh import Mesh as Mesh
from resgrid.robots.point import DiscRobot as DiscRobot, PointRobot as PointRobot
from resgrid.robots.polygon import PolygonRobot as PolygonRobot
from resgrid.robots.shapes import (
    Ball as Ball,
    Box as Box,
    CellSet as CellSet,
    HalfSpace as HalfSpace,
    Polygon as Polygon,
    Shape as Shape,
    to_shapely as to_shapely,
)
from resgrid.robots.solids import Capsule as Capsule, Cylinder as Cylinder, OrientedBox as OrientedBox
from resgrid.robots.urdf.robot import URDFRobot as URDFRobot
from resgrid.robots.voxels import Voxels as Voxels

ROBOTS: dict[str, type[Robot]] = {
    "point": PointRobot,
    "disc": DiscRobot,
    "polygon": PolygonRobot,
    "arm": Arm,
    "urdf": URDFRobot,
}
"""Robot classes by the value of the key `robot.type` in scene files."""
