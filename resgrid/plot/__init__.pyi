"""Public names of `resgrid.plot`."""

from .control import draw_dirichlet_fraction as draw_dirichlet_fraction, draw_velocities as draw_velocities
from .fields import draw_summary as draw_summary
from .figures import save_figure as save_figure
from .voxels import draw_voxels as draw_voxels
from .workspace import (
    draw_robot as draw_robot,
    draw_tip_paths as draw_tip_paths,
    draw_workspace_and_space as draw_workspace_and_space,
)
