"""Frames of the animation of an arm along a trajectory."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure

from resgrid.planning.time_parameterization import Trajectory
from resgrid.plot.arms import END, START, ArmPicture
from resgrid.plot.figures import new_figure, panel_height, settle_layout
from resgrid.plot.raster import Camera
from resgrid.plot.style import PATHS, TEXT, add_swatch, mark, refresh_legend
from resgrid.scene.scene import Scene

_WIDTH = 4.6
"""Width of a frame in inches."""

_SIDE = 900
"""Number of pixels along the longer side of a frame's image before it is reduced to half this size."""

_ENVELOPE = 24
"""Approximate number of poses along the trajectory that the limits of the picture must contain."""

_DENSE = 400
"""Number of evenly spaced times at which the path of the tool is computed."""

_GHOST = 0.25
"""Opacity, from 0 (transparent) to 1, of the robot at the start and at the end, which every frame shows."""


def arm_frames(trajectory: Trajectory, scene: Scene, count: int, held: int) -> Iterator[Figure]:
    """Yield the figure of an arm along a trajectory, redrawn for each of `count` evenly spaced times.

    `scene`: scene with the arm and its obstacles; `held`: number of additional frames that repeat the last frame.
    """
    times = np.linspace(0.0, trajectory.duration, _DENSE)
    motion = trajectory.at(times)[0]
    tool = scene.robot.reference_point(motion)
    picture = ArmPicture(scene, motion[:: _DENSE // _ENVELOPE], Camera(), tool, _SIDE)
    window = picture.window
    aspect = (window.top - window.bottom) / (window.right - window.left)
    figure = new_figure(_WIDTH, panel_height(_WIDTH - 0.4, aspect))
    axes = figure.add_subplot()
    picture.prepare(axes)
    mark(picture.camera.seen(tool[:1])[:, :2], axes, "start", "")
    around = picture.surroundings()
    ends = [
        picture.layer(picture.moved(pose, behind=0.005), colour, _GHOST)
        for pose, colour in ((motion[0], START), (motion[-1], END))
    ]
    add_swatch(axes, "robot", END)
    axes.plot([], [], color=PATHS[0], label="path of the tool")
    refresh_legend(axes, gap=1.0)
    axes.set_title(" ", fontsize=TEXT)
    settle_layout(figure)
    for time in np.linspace(0.0, trajectory.duration, count):
        pose = trajectory.at([time])[0][0]
        robot = picture.layer(picture.moved(pose), END)
        moving: list[Artist] = [picture.show([robot, *around, *ends], axes)]
        passed = tool[times <= time]
        if len(passed) > 1:
            moving += picture.draw_line(passed, axes, [robot, *around], "")
        axes.set_title(f"{time:.2f} s of {trajectory.duration:.2f} s", fontsize=TEXT)
        for _ in range(1 + (held if time == trajectory.duration else 0)):
            yield figure
        for artist in moving:
            artist.remove()
