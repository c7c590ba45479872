"""
Write and check a SPICE deck
============================

Write the chip of the lesson as a portable deck, and check its electrical rules.
"""

from pathlib import Path

import resgrid as rg

SCENES = Path(__file__).resolve().parents[1] / "scenes"
Path("out").mkdir(exist_ok=True)

# %%
# The same scene gives the same bytes. The sidecar of the deck contains the expected voltages.

op = rg.solve(rg.compile_space(rg.build_space(rg.read_scene(SCENES / "lesson.toml"))))
rg.write_spice(op, "out/lesson.cir")
print("\n".join(Path("out/lesson.cir").read_text().splitlines()[:9]))

# %%
# Read back, the deck is the same circuit: it has no rule violations and the same power.

deck = rg.read_spice("out/lesson.cir")
again = rg.solve(deck)
assert not [violation for violation in rg.check_erc(deck) if violation.severity == "error"]
assert abs(again.power / op.power - 1) < 1e-12
print(f"{op.power * 1e6:.2f} uW")
rg.plot.save_figure(rg.draw(op), "out/deck.png")
