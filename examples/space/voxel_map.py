"""
A drone in a scanned room
=========================

Plan in the voxels of a point cloud, without a scene file.
"""

from pathlib import Path

import numpy as np

import resgrid as rg

Path("out").mkdir(exist_ok=True)

# %%
# The cloud is a scan of the floor and the walls of a room with two shelves. A real one is a ``.pcd`` or ``.ply`` file.

rng = np.random.default_rng(1)


def sheet(lower, upper, count=4000):
    """Return random points in a box, which is thin for a wall."""
    return rng.uniform(lower, upper, (count, 3))


room = [
    sheet((0, 0, 0), (6, 4, 0.05), 12000),
    sheet((0, 3.95, 0), (6, 4, 2.4), 8000),
    sheet((0, 0, 0), (0.05, 4, 2.4), 6000),
    sheet((5.95, 0, 0), (6, 4, 2.4), 6000),
    sheet((1.9, 0, 0), (2.2, 3, 1.9), 9000),
    sheet((3.9, 1, 0), (4.2, 4, 2.4), 9000),
]
points = np.concatenate(room)
head = f"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH {len(points)}\nHEIGHT 1\nDATA ascii\n"
rows = "\n".join(f"{x:.3f} {y:.3f} {z:.3f}" for x, y, z in points)
Path("out/scan.pcd").write_text(head + rows)

# %%
# A voxel that contains a point is an obstacle. The drone is a ball with a radius of 20 cm.

robot = rg.PointRobot(0.2)
scene = rg.read_scene("out/scan.pcd", spacing=0.15, robot=robot, start=(0.7, 0.8, 0.6), goal=(5.3, 3.3, 1.5))
path = rg.plan(scene).paths()[0]
rg.certify(path)
print(path)
assert path.outcome == "reached"

# %%
# The figure shows the surface of the obstacles, grown by the drone's radius, and slices at heights of the path.

rg.plot.save_figure(rg.draw(path), "out/voxel_map.png")
