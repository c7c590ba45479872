"""The live page: a browser editor of obstacles, goals and starts that solves the grid after every change.

All computations run in Python.  The page stores the drawing (cells, starts and settings) and displays the results that
the server sends.
"""

from resgrid.live_page.launch import LivePage, live, serve

__all__ = ["LivePage", "live", "serve"]
