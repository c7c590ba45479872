"""
Thermal noise
=============

Compute the thermal noise of the resistors at every node.
"""

from pathlib import Path

import numpy as np

import resgrid as rg

SCENES = Path(__file__).resolve().parents[1] / "scenes"
Path("out").mkdir(exist_ok=True)

# %%
# The noise voltage of a resistor network on a capacitor is at most :math:`\sqrt{kT/C}`, for any resistances.

study = rg.study(rg.read_scene(SCENES / "chip.toml"))
noise = study.noise()
limit = np.max(noise.limit[np.isfinite(noise.limit)])
print(f"at most {limit * 1e6:.0f} uV rms at {noise.temperature:.1f} K")
expected = np.sqrt(1.380649e-23 * noise.temperature / 60e-15)
assert abs(limit / expected - 1) < 1e-6
rg.plot.save_figure(rg.draw(noise), "out/noise.png")
