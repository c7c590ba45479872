"""
Yield of a chip
===============

Analyse a planning chip of 16 x 16 cells with real resistors, switches, rails and a converter of 12 bits.
"""

from pathlib import Path

import resgrid as rg

SCENES = Path(__file__).resolve().parents[1] / "scenes"
Path("out").mkdir(exist_ok=True)

# %%
# A study holds one chip, and its methods are the analyses. Results contain figures with units and definitions.

study = rg.study(rg.read_scene(SCENES / "chip.toml"))
settling, noise, power = study.settling(), study.noise(), study.power()
for result in (settling, noise, power):
    for name, figure in list(result.figures.items())[:3]:
        value = "none" if figure.value is None else f"{figure.value:.4g}"
        print(f"{name}: {value} {figure.unit}")
rg.plot.save_figure(rg.draw(settling), "out/settling.png")

# %%
# The yield is the fraction of starts that have a path to a goal, over randomly drawn chips.

yields = study.yields(trials=128)
print(f"{yields.overall.value:.1%} of starts are served ({yields.overall.low:.1%} to {yields.overall.high:.1%})")
assert yields.overall.low <= yields.overall.value <= yields.overall.high
rg.plot.save_figure(rg.draw(yields), "out/yield.png")

# %%
# Causes of yield loss: each effect is switched off in turn, on the same dies. Then mismatch, offset and bits are
# changed until fewer than 99 % of the starts are served.

loss = study.yield_loss(trials=64)
for cause in loss.causes[:3]:
    print(f"without {cause.name}: {cause.share.value:.1%} ({100 * cause.gain:+.1f} points)")
for limit in loss.limits:
    print(f"{limit.name}: {limit.answer}")
rg.plot.save_figure(rg.draw(loss), "out/yield_loss.png")
