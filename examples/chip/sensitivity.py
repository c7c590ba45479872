"""
Sensitivity to resistors
========================

Find the resistors whose drift would change a step of the robot.
"""

from pathlib import Path

import numpy as np

import resgrid as rg

SCENES = Path(__file__).resolve().parents[1] / "scenes"
Path("out").mkdir(exist_ok=True)

# %%
# Every step leads to the neighbour of lowest potential. The margin is the voltage difference to the second lowest one.

study = rg.study(rg.read_scene(SCENES / "chip.toml"))
sensitivity = study.sensitivity()
for name, figure in list(sensitivity.figures.items())[:4]:
    print(f"{name}: {figure.value} {figure.unit}")
assert (sensitivity.margin[np.isfinite(sensitivity.margin)] >= 0).all()
rg.plot.save_figure(rg.draw(sensitivity), "out/sensitivity.png")
