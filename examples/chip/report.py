"""
Is this chip good enough?
=========================

A planning chip of 16 x 16 cells with real resistors, switches, rails and a converter of 12 bits.
"""

from pathlib import Path

import resgrid as rg

SCENES = Path(__file__).resolve().parents[1] / "scenes"
Path("out").mkdir(exist_ok=True)

# %%
# A study is one chip, and every question that can be asked about it. What comes back knows its figures, units and
# definitions.

study = rg.study(rg.read_scene(SCENES / "chip.toml"))
settling, noise, power = study.settling(), study.noise(), study.power()
for result in (settling, noise, power):
    for name, figure in list(result.figures.items())[:3]:
        value = "none" if figure.value is None else f"{figure.value:.4g}"
        print(f"{name}: {value} {figure.unit}")
rg.plot.save_figure(rg.draw(settling), "out/settling.png")

# %%
# The yield: the share of chips on which a start has a path, over chips drawn at random.

yields = study.yields(trials=128)
print(f"{yields.overall.value:.1%} of starts are served ({yields.overall.low:.1%} to {yields.overall.high:.1%})")
assert yields.overall.low <= yields.overall.value <= yields.overall.high
rg.plot.save_figure(rg.draw(yields), "out/yield.png")

# %%
# What costs yield? Each effect is switched off in turn, on the same dies; then mismatch, offset and bits are changed
# until fewer than 99 % of the starts are served.

loss = study.yield_loss(trials=64)
for cause in loss.causes[:3]:
    print(f"without {cause.name}: {cause.share.value:.1%} ({100 * cause.gain:+.1f} points)")
for limit in loss.limits:
    print(f"{limit.name}: {limit.answer}")
rg.plot.save_figure(rg.draw(loss), "out/yield_loss.png")
