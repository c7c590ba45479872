from __future__ import annotations

import pytest
from support.hand_made_robot import HandMadeRobot

import resgrid as rg


@pytest.fixture(scope="session")
def arm_scene() -> rg.Scene:
    """An arm of two joints next to a wall, which its forearm can pass on both sides."""
    robot = HandMadeRobot(tool="hand")
    wall = rg.Box((0.3, 0.45, 0.0), (0.5, 0.65, 0.6))
    return rg.Scene(
        robot.axes(20), robot=robot, obstacles=(wall,), goals=(rg.Ball((-0.6, 0.4, 0.3), 0.12),), starts=((-0.3, 0.2),),
        boundary="neumann", title="Two links",
    )  # fmt: skip
