"""The 3-D view of an arm in the browser: a slider along the path, and handles for start and goal that plan again.

The packages of the extra ``viewer`` (viser) show the scene; all computations run in Python.
"""

from resgrid.viewer.launch import Viewer, view

__all__ = ["Viewer", "view"]
