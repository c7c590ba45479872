"""
Bold or careful
===============

One knob between obstacles that repel and obstacles that merely bound.
"""

from pathlib import Path

import resgrid as rg

SCENES = Path(__file__).resolve().parents[1] / "scenes"
Path("out").mkdir(exist_ok=True)

# %%
# Two circuits of one flat. Dirichlet: obstacles are held at 1 V, the current leaves them at right angles, and the robot
# keeps away. Neumann: obstacles are open, the current slides along them, and the robot comes close to them.

scene = rg.read_scene(SCENES / "rooms.toml")
space = rg.build_space(scene)
dirichlet = rg.field(rg.solve(rg.compile_space(space, boundary="dirichlet")))
neumann = rg.field(rg.solve(rg.compile_space(space, boundary="neumann")))

# %%
# k mixes them (Connolly & Grupen 1992). Neither half has a local minimum, nor has a sum of
# superharmonic functions: every blend keeps the promises.

blends = (0.0, 0.5, 1.0)
paths = [rg.streamline(rg.blend(dirichlet, neumann, k), scene.starts[0]) for k in blends]
for k, path in zip(blends, paths, strict=True):
    rg.certify(path)
    print(f"k = {k:g}: {path.length:.2f} m long, {path.clearance:.3f} m clear of obstacles")

clearance = [path.clearance for path in paths]
assert clearance == sorted(clearance)

# %%
# The three paths, over the potential of k = 0.

axes = rg.draw(neumann)
rg.draw(paths, axes, k=blends)
axes.set_title("Blends over the Neumann potential", fontsize=9)
rg.plot.save_figure(axes, "out/blend.png")
