"""Matplotlib pictures: `draw` draws a value on an ax and returns the ax; `save_figure` and `animate` write files."""

from resgrid.plot.animations import animate
from resgrid.plot.control import draw_dirichlet_share, draw_velocities
from resgrid.plot.fields import draw_page
from resgrid.plot.figures import add_title, figure_of, new_figure, render_figure, save_figure
from resgrid.plot.pictures import draw
from resgrid.plot.workspace import draw_pair, draw_robot, draw_tips

__all__ = [
    "add_title",
    "animate",
    "draw",
    "draw_dirichlet_share",
    "draw_page",
    "draw_pair",
    "draw_robot",
    "draw_tips",
    "draw_velocities",
    "figure_of",
    "new_figure",
    "render_figure",
    "save_figure",
]
