"""
Blends of Dirichlet and Neumann
===============================

The parameter k blends a field that keeps away from obstacles with a field that slides along them.
"""

from pathlib import Path

import resgrid as rg

SCENES = Path(__file__).resolve().parents[1] / "scenes"
Path("out").mkdir(exist_ok=True)

# %%
# A flat gives two circuits. Dirichlet: obstacles are at 1 V, the current leaves them at right angles, and the robot
# keeps away from them. Neumann: obstacles are open, the current flows along them, and the robot can come close to them.

scene = rg.read_scene(SCENES / "rooms.toml")
space = rg.build_space(scene)
dirichlet = rg.field(rg.solve(rg.compile_space(space, boundary="dirichlet")))
neumann = rg.field(rg.solve(rg.compile_space(space, boundary="neumann")))

# %%
# The blend is k times Dirichlet plus 1 - k times Neumann (Connolly & Grupen 1992). Both potentials are superharmonic,
# and so is their sum. No blend has a local minimum, and its streamlines can be certified.

blends = (0.0, 0.5, 1.0)
paths = [rg.streamline(rg.blend(dirichlet, neumann, k), scene.starts[0]) for k in blends]
for k, path in zip(blends, paths, strict=True):
    rg.certify(path)
    print(f"k = {k:g}: {path.length:.2f} m long, {path.clearance:.3f} m clear of obstacles")

clearance = [path.clearance for path in paths]
assert clearance == sorted(clearance)

# %%
# The figure shows the three paths over the potential of k = 0.

axes = rg.draw(neumann)
rg.draw(paths, axes, k=blends)
axes.set_title("Blends over the Neumann potential", fontsize=9)
rg.plot.save_figure(axes, "out/blend.png")
