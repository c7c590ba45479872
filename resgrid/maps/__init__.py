"""Public names for maps, meshes, point clouds, recordings and ROS messages, and for planning on a recorded stream.

This file contains no code: readers are in `resgrid.scene`, writers in `resgrid.io`, stream planners in
`resgrid.planning`.

>>> [name for name in dir(rg.maps) if name.startswith("read")]
['read_bag', 'read_mesh', 'read_movingai_scenarios', 'read_octomap', 'read_point_cloud']
"""

from resgrid._internal.public import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
