"""Scenes: user input that describes a robot, its surroundings and the chip, from TOML files and maps."""

from resgrid.scene.chip import Chip as Chip, Defects as Defects, Readout as Readout
from resgrid.scene.control import Control as Control
from resgrid.scene.goals import (
    CostArea as CostArea,
    GoalCell as GoalCell,
    GoalJoints as GoalJoints,
    GoalPoint as GoalPoint,
    GoalPose as GoalPose,
)
from resgrid.scene.maps.arrays import MapCells as MapCells
from resgrid.scene.maps.movingai import (
    MovingAIScenario as MovingAIScenario,
    read_movingai_scenarios as read_movingai_scenarios,
)
from resgrid.scene.maps.ros import from_occupancy_grid as from_occupancy_grid
from resgrid.scene.mask import Mask as Mask
from resgrid.scene.reading import parse_scene as parse_scene, read_scene as read_scene
from resgrid.scene.sampling import build_space as build_space
from resgrid.scene.scene import Scene as Scene
