"""
Layout on an open process
=========================

Draw the resistor grid of a map as a chip layout in IHP SG13G2, and let KLayout extract it.
"""

from pathlib import Path

import resgrid as rg

SCENES = Path(__file__).resolve().parents[1] / "scenes"
Path("out").mkdir(exist_ok=True)

# %%
# Every resistor is a serpentine of the process. The summary has the pitch of the cells, the area, and the voltage drops
# along the rails.

scene = rg.read_scene(SCENES / "rooms.toml").replace(boundary="dirichlet")
space = rg.build_space(scene)
layout = rg.hardware.build_layout(space, "ihp-sg13g2:rppd", resistance=10e3)
summary = layout.summary()
width, height = (1e6 * side for side in summary["pitch"])
print(f"{summary['resistors']} resistors, {width:.2f} x {height:.2f} um per cell, {1e6 * summary['area']:.3f} mm^2")
for net, drop in summary["rails"]["drop"].items():
    print(f"voltage drop along the rail of {net}: {1e3 * drop:.2g} mV")
rg.plot.save_figure(rg.draw(layout), "out/layout.png")

# %%
# A high resistance per square saves area: the same grid in rhigh.

high = rg.hardware.build_layout(space, "ihp-sg13g2:rhigh", resistance=10e3)
print(f"rhigh: {1e12 * high.pitch[0] * high.pitch[1] / (width * height):.0%} of the area of a cell in rppd")
assert high.pitch[0] * high.pitch[1] < layout.pitch[0] * layout.pitch[1]
