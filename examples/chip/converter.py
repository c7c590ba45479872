"""
Resolution of the converter
===========================

Compute the number of read-out bits with which the robot reaches a goal from every start.
"""

from pathlib import Path

import numpy as np

import resgrid as rg

SCENES = Path(__file__).resolve().parents[1] / "scenes"
Path("out").mkdir(exist_ok=True)

# %%
# `precision` returns, for every start, the number of bits that decides all steps of its path.

scene = rg.read_scene(SCENES / "chip.toml")
boundaries = ("dirichlet", "neumann")
found = {name: rg.study(scene.replace(boundary=name)).adc_resolution() for name in boundaries}
for name, resolution in found.items():
    bits = resolution.start_bits[np.isfinite(resolution.start_bits)]
    print(f"{name}: {np.ceil(bits.max()):.0f} bits serve every start, {np.ceil(np.median(bits)):.0f} half of them")
    assert bits.max() >= np.median(bits)

rg.plot.save_figure(rg.draw(found["dirichlet"]), "out/bits.png")
rg.plot.save_figure(rg.draw(found, quantity="served"), "out/served.png")
