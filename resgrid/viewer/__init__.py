"""The 3-D view of an arm, a point or a ball in the browser: a slider along the path, and handles for start and goal.

A move of the start or the goal plans again.  The packages of the extra ``viewer`` (viser) show the scene; all
computations run in Python.
"""

from resgrid.viewer.launch import Viewer, view

__all__ = ["Viewer", "view"]
