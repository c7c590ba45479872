"""
Use the controller in your own loop
===================================

The loop reads encoders and torque sensors, computes a velocity by ``controller.command(q, tau)``, and commands this
velocity. The robot in this example is a simulated disc that is pushed; replace the class by the driver of your robot.
"""

from pathlib import Path

import numpy as np

import resgrid as rg

SCENES = Path(__file__).resolve().parents[1] / "scenes"
Path("out").mkdir(exist_ok=True)
PERIOD = 0.05  # seconds: 20 Hz


class ToyRobot:
    """A simulated driver: it executes velocities exactly, and is pushed to the right from 12 s to 14 s."""

    def __init__(self, q):
        self.q, self.time = np.array(q, dtype=float), 0.0

    def read(self):
        """Return the configuration and the generalised external force (without gravity)."""
        pushed = 12.0 <= self.time < 14.0
        return self.q.copy(), np.array([0.8 if pushed else 0.0, 0.0])

    def move(self, qdot):
        """Move with this velocity for one control period."""
        self.q += PERIOD * qdot
        self.time += PERIOD


# %%
# Before the robot moves, compute the field of the map, and a controller that follows its current.

scene = rg.read_scene(SCENES / "rooms.toml")
field = rg.plan(scene, k=0.9).field
controller = rg.control.make_controller(field, speed=0.4, admittance=0.5, speed_limits=1.0)

# %%
# The control loop uses world coordinates. The command is :math:`V = V_0 + A F`: an external force moves the robot off
# its streamline, and afterwards the robot follows the streamline through its new position.

robot = ToyRobot(scene.starts[0])
way = [robot.q.copy()]
while field.space.cell[tuple(field.space.locate(robot.q))] != rg.Cell.GOAL:
    q, tau = robot.read()
    robot.move(controller.command(q, tau))
    way.append(robot.q.copy())
    assert len(way) < 10_000, "the robot did not arrive"

planned = rg.streamline(field, scene.starts[0])
off = max(float(np.linalg.norm(planned.points - point, axis=1).min()) for point in way)
print(f"arrived after {robot.time:.2f} s and {len(way) - 1} commands, at most {off:.2f} m off the first streamline")
assert off > 0.3 and robot.time < 25

axes = rg.draw(field)
rg.draw(planned, axes)
axes.plot(*np.array(way).T, color="black", label="trajectory of the robot, pushed from 12 s to 14 s", zorder=5)
axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), fontsize=7, frameon=False, ncols=2)
rg.plot.save_figure(axes, "out/own_loop.png")
