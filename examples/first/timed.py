"""
A path for a controller
=======================

Shorten a path, time it under limits of speed and acceleration, and check the result.
"""

from pathlib import Path

import numpy as np

import resgrid as rg

SCENES = Path(__file__).resolve().parents[1] / "scenes"
Path("out").mkdir(exist_ok=True)

# %%
# `shortcut` replaces bends by straight segments that cross free cells only.

scene = rg.read_scene(SCENES / "rooms.toml")
path = rg.plan(scene).path(scene.starts[0])
short = rg.shortcut(path)
rg.certify_collision_free(short)
print(f"{path.length:.2f} m along the current, {short.length:.2f} m shortened")
assert short.length < path.length

# %%
# `time_parameterize` computes a fast motion with at most 1 m/s and 2 m/s^2.

motion = rg.time_parameterize(short, velocity_limits=1.0, acceleration_limits=2.0)
times, positions, velocities = motion.sample(50)[:3]
speed = np.linalg.norm(velocities, axis=1)
print(f"{motion.times[-1]:.2f} s")
assert speed.max() <= 1.0 + 1e-9

rg.save(motion, "out/path.csv")
axes = rg.draw(rg.build_space(scene))
rg.draw(path, axes)
points = axes.scatter(*positions.T, c=speed, s=4, cmap="BuPu", zorder=6)
axes.figure.colorbar(points, ax=axes, label="speed [m/s]")
axes.set_title("The streamline and the timed path", fontsize=9)
rg.plot.save_figure(axes, "out/timed.png")
