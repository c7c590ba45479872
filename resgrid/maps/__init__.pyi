"""Public names of `resgrid.maps`."""

from resgrid.io.ros_paths import to_ros_path as to_ros_path
from resgrid.io.ros_trajectories import to_ros_trajectory as to_ros_trajectory
from resgrid.scene.maps.arrays import MapCells as MapCells
from resgrid.scene.maps.movingai import (
    MovingAIScenario as MovingAIScenario,
    read_movingai_scenarios as read_movingai_scenarios,
)
from resgrid.scene.maps.ros import from_occupancy_grid as from_occupancy_grid
