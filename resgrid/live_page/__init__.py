"""The live page: walls are painted and goals dragged in a browser, and the grid is solved anew while one draws.

Python is the only engine; the page holds what is drawn, and shows what it is sent.
"""

from resgrid.live_page.launch import LivePage, live, serve

__all__ = ["LivePage", "live", "serve"]
