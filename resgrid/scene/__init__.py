"""Scenes: what a person writes, or a map says, about a robot, its surroundings and the chip."""

from resgrid.scene.chip import Chip as Chip, Defects as Defects, Readout as Readout
from resgrid.scene.control import Control as Control
from resgrid.scene.goals import (
    CostArea as CostArea,
    GoalCell as GoalCell,
    GoalJoints as GoalJoints,
    GoalPoint as GoalPoint,
)
from resgrid.scene.maps.arrays import MapCells as MapCells
from resgrid.scene.maps.movingai import MovingAIScenario as MovingAIScenario, read_queries as read_queries
from resgrid.scene.maps.ros import occupancy_grid as occupancy_grid
from resgrid.scene.reading import parse_scene as parse_scene, read_scene as read_scene
from resgrid.scene.sampling import sample as sample
from resgrid.scene.scene import Scene as Scene
