"""
How fast may a robot be?
========================

An obstacle appears while the robot is on its way, and the grid needs time to settle: a robot that outruns it follows a
field of yesterday.
"""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import resgrid as rg

Path("out").mkdir(exist_ok=True)

# %%
# A wall is put on the map at time 0. The potential relaxes by sweeps of successive over-relaxation, so many while the
# robot crosses one cell: a slow robot leaves the grid a hundred, the fastest makes a hundred cells in one sweep.

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
    print(f"{pace:6g} sweeps a cell: {run.ending} after {run.time[-1]:.1f} s, {len(run.contacts.step)} contacts")

# %%
# The slowest do as well as on a grid that settles at once; then robots run after a moving field, and the fastest gets
# stuck. But none touches the wall: the rails know it at once, only the free cells do not.

at_once = rg.simulation(scene.replace(obstacles=scene.hidden, hidden=()), k=0.98).run()
assert abs(runs[0].time[-1] / at_once.time[-1] - 1) < 0.02
assert all(arrived[:3]) and not arrived[-1]
assert not any(len(run.contacts.step) for run in runs)

figure = Figure((9.6, 4.4), layout="constrained")
left, right = figure.subplots(1, 2, width_ratios=(1, 1.2))
rg.draw(rg.build_space(scene.replace(obstacles=scene.hidden)), left)
for pace, run, colour in zip(sweeps[::2], runs[::2], ("#0072b2", "#009e73", "#e69f00", "#d55e00"), strict=True):
    left.plot(*run.configuration.T, color=colour, lw=1.5, label=f"{pace:g} sweeps a cell", zorder=4)
left.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14), fontsize=7, frameon=False, ncols=3)
times = np.array([run.time[-1] for run in runs])
right.plot(sweeps, times, color="0.6", zorder=1)
for mark, name, chosen in (("o", "arrived", arrived), ("X", "stuck", [not done for done in arrived])):
    right.scatter(np.array(sweeps)[chosen], times[chosen], marker=mark, s=45, label=name, zorder=2)
right.axhline(at_once.time[-1], color="black", ls="--", lw=1, label="grid that settles at once")
right.set(xscale="log", xlabel="sweeps while the robot crosses a cell", ylabel="time of the run (s)", ylim=(0, None))
right.legend(fontsize=7, frameon=False)
rg.plot.save_figure(figure, "out/settling.png")
