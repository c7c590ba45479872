"""
Robot speed and settling time
=============================

An obstacle appears while the robot moves, and the grid needs time to settle. If the robot is too fast, it follows an
outdated field.
"""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import resgrid as rg

Path("out").mkdir(exist_ok=True)

# %%
# A wall is added to the map at time 0. The potential relaxes by sweeps of successive over-relaxation. `pace` is the
# number of sweeps while the robot crosses one cell: 100 for the slowest robot, and 0.01 for the fastest.

scene = rg.Scene(
    (rg.Axis("x", 0, 8, 32), rg.Axis("y", 0, 8, 32)),
    hidden=(rg.Box((2.0, 3.0), (6.5, 4.0)),),
    goals=(rg.GoalPoint((4.2, 0.7)),),
    starts=((4.2, 7.2),),
)
sweeps = (100.0, 10.0, 1.0, 0.3, 0.1, 0.03, 0.01)
runs = [rg.simulation(scene, k=0.98, announce=True, settle="sor", pace=pace).run() for pace in sweeps]
arrived = [run.ending == rg.control.TerminationReason.ARRIVED for run in runs]
for pace, run in zip(sweeps, runs, strict=True):
    print(f"{pace:6g} sweeps per cell: {run.ending} after {run.time[-1]:.1f} s, {len(run.contacts.step)} contacts")

# %%
# The slowest robots are as fast as on a grid that settles immediately. Faster robots follow a changing field and take
# longer, and the fastest robot gets stuck. No robot touches the wall, because the rails change immediately.

at_once = rg.simulation(scene.replace(obstacles=scene.hidden, hidden=()), k=0.98).run()
assert abs(runs[0].time[-1] / at_once.time[-1] - 1) < 0.02
assert all(arrived[:3]) and not arrived[-1]
assert not any(len(run.contacts.step) for run in runs)

figure = Figure((9.6, 4.4), layout="constrained")
left, right = figure.subplots(1, 2, width_ratios=(1, 1.2))
rg.draw(rg.build_space(scene.replace(obstacles=scene.hidden)), left)
for pace, run, colour in zip(sweeps[::2], runs[::2], ("#0072b2", "#009e73", "#e69f00", "#d55e00"), strict=True):
    left.plot(*run.configuration.T, color=colour, lw=1.5, label=f"{pace:g} sweeps per cell", zorder=4)
left.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14), fontsize=7, frameon=False, ncols=3)
times = np.array([run.time[-1] for run in runs])
right.plot(sweeps, times, color="0.6", zorder=1)
for mark, name, chosen in (("o", "arrived", arrived), ("X", "stuck", [not done for done in arrived])):
    right.scatter(np.array(sweeps)[chosen], times[chosen], marker=mark, s=45, label=name, zorder=2)
right.axhline(at_once.time[-1], color="black", ls="--", lw=1, label="grid that settles immediately")
right.set(xscale="log", xlabel="sweeps while the robot crosses a cell", ylabel="time of the run (s)", ylim=(0, None))
right.legend(fontsize=7, frameon=False)
rg.plot.save_figure(figure, "out/settling.png")
