"""
A board for a class
===================

Build a printed circuit board of the lesson: a fixed board, and one with solder bridges that serves every scene.
"""

from pathlib import Path

import resgrid as rg

SCENES = Path(__file__).resolve().parents[1] / "scenes"
Path("out").mkdir(exist_ok=True)

# %%
# A fixed board shows the scene on its silkscreen: its front, and the expected voltages.

scene = rg.read_scene(SCENES / "lesson.toml")
board = rg.hardware.build_board(scene)
print(board, f"{board.supply_current * 1e6:.1f} uA from {scene.chip.supply:g} V")
assert max(board.size) < 100

rg.plot.save_figure(rg.draw(board, side="front"), "out/board_front.png")
rg.plot.save_figure(rg.draw(board), "out/board_voltages.png")

# %%
# On a board with jumpers, solder bridges make a cell an obstacle (O) or a goal (G).

jumpers = rg.hardware.build_board(scene, kind="jumpers")
assert len(jumpers.closed) == 8
rg.plot.save_figure(rg.draw(jumpers, side="front"), "out/jumpers_front.png")
rg.plot.save_figure(rg.draw(jumpers), "out/jumpers_plan.png")

# %%
# The yield of boards with resistors of 1 % and 5 % tolerance, read by a converter of 12 bits.

for tolerance in (0.01, 0.05):
    print(f"{tolerance:.0%}: {rg.hardware.build_board(scene, tolerance=tolerance).yields(bits=12, trials=128).overall}")
