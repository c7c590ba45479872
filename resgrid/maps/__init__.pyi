"""Public names of `resgrid.maps`."""

from resgrid.io.bags import write_bag as write_bag
from resgrid.io.ros_paths import path_poses as path_poses, to_ros_path as to_ros_path
from resgrid.io.ros_trajectories import to_ros_trajectory as to_ros_trajectory
from resgrid.io.streams import StreamReport as StreamReport, stream_bag as stream_bag
from resgrid.planning.stream_planner import StreamedPath as StreamedPath, StreamPlanner as StreamPlanner
from resgrid.scene.maps.arrays import MapCells as MapCells
from resgrid.scene.maps.movingai import (
    MovingAIScenario as MovingAIScenario,
    read_movingai_scenarios as read_movingai_scenarios,
)
from resgrid.scene.maps.ros import from_occupancy_grid as from_occupancy_grid
from resgrid.scene.recordings.recording import Recording as Recording, read_bag as read_bag
from resgrid.scene.recordings.snapshot import MapSnapshot as MapSnapshot
from resgrid.scene.solids.mesh_files import read_mesh as read_mesh
from resgrid.scene.solids.octomap import read_octomap as read_octomap
from resgrid.scene.solids.point_clouds import read_point_cloud as read_point_cloud
