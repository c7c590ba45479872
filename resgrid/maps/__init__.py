"""Maps of robots and benchmarks: ROS occupancy grids and paths, MovingAI scenarios.

>>> sorted(dir(rg.maps))
['MapCells', 'MovingAIScenario', 'from_occupancy_grid', 'read_movingai_scenarios', 'to_ros_path']
"""

from resgrid._internal.public import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
