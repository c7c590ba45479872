"""
Which resistors decide
======================

Drifts that would turn a robot's step to another neighbour.
"""

from pathlib import Path

import numpy as np

import resgrid as rg

SCENES = Path(__file__).resolve().parents[1] / "scenes"
Path("out").mkdir(exist_ok=True)

# %%
# Every step goes to the neighbour of lowest potential; the runner-up is some margin away.

study = rg.study(rg.read_scene(SCENES / "chip.toml"))
sensitivity = study.sensitivity()
for name, figure in list(sensitivity.figures.items())[:4]:
    print(f"{name}: {figure.value} {figure.unit}")
assert (sensitivity.margin[np.isfinite(sensitivity.margin)] >= 0).all()
rg.plot.save_figure(rg.draw(sensitivity), "out/sensitivity.png")
