"""Controlled motions as files and as text: a log of every step, and what each run came to."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from resgrid.cli.job import Job, place_of
from resgrid.cli.output import emit_file, emit_text
from resgrid.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from resgrid.control.log import Run
    from resgrid.control.simulation import Simulation
    from resgrid.space import Axis

SUFFIXES = (".npz", ".csv")


@dataclass(frozen=True, eq=False)
class Motion:
    """A run, and what it belongs to."""

    start: tuple[float, ...]
    k: float
    run: Run
    simulation: Simulation


def check_log(target: str, axes: Sequence[Axis] = ()) -> None:
    """Refuse a log that cannot be written, before anything is computed."""
    from resgrid.planning.export import require_names

    if not target.lower().endswith(".npz"):
        names = [axis.name for axis in axes]
        require_names(axes, csv_names(names)[:4] + csv_names(names)[4 + len(names) :])
    if target != "-" and Path(target).suffix.lower() not in SUFFIXES:
        raise InputError(f"-o {target}: a log is written as .npz or .csv, and this name ends in neither")


def write_log(target: str, motions: Sequence[Motion], job: Job) -> None:
    """Write every step of every run as the target's suffix says: ``.npz``, or ``.csv`` (also ``-``)."""
    if target != "-" and Path(target).suffix.lower() == ".npz":
        emit_file(target, ".npz", lambda path: _write_npz(path, motions))
    else:
        emit_text(target, csv_text(motions, job))


def columns_of(run: Run) -> dict[str, NDArray[np.generic]]:
    """Every column of a run, in world coordinates; those of contacts begin with ``contact_``."""
    felt = run.contacts
    return {
        "time": run.time,
        "mode": run.mode,
        "configuration": run.configuration,
        "believed": run.believed,
        "velocity": run.velocity,
        "torque": run.torque,
        "push": run.push,
        "learnt": run.learnt,
        "contact_step": felt.step,
        "contact_point": felt.point,
        "contact_normal": felt.normal,
        "contact_force": felt.force,
        "contact_gap": felt.gap,
        "contact_part": felt.part,
        "contact_body": felt.body,
        "contact_sticking": felt.sticking,
    }


def csv_names(axes: Sequence[str]) -> list[str]:
    """Names of the columns of a table of runs, for axes of some names."""
    kinds = ("", "_believed", "_rate", "_torque", "_push")
    contact = ("contact_x", "contact_y", "force_x", "force_y", "part", "body", "sticking")
    return ["run", "k", "t", "mode", *(name + kind for kind in kinds for name in axes), "contacts", *contact]


def csv_text(motions: Sequence[Motion], job: Job) -> str:
    """Runs as a table, one step a line, in world coordinates; of several contacts of a step, the strongest."""
    import csv

    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(csv_names([axis.name for axis in job.space.axes]))
    for number, motion in enumerate(motions):
        table.writerows([number, repr(motion.k), *row] for row in _rows(columns_of(motion.run)))
    return text.getvalue()


def _rows(columns: dict[str, NDArray[Any]]) -> list[list[str]]:
    import numpy as np

    from resgrid.control.log import Mode

    values = np.hstack([columns[name] for name in ("configuration", "believed", "velocity", "torque", "push")]).tolist()
    force, steps = columns["contact_force"], columns["contact_step"]
    size = np.hypot(*force.T)
    rows = []
    for step, (time, mode) in enumerate(zip(columns["time"].tolist(), columns["mode"].tolist(), strict=True)):
        first, last = np.searchsorted(steps, [step, step + 1]).tolist()
        strongest = [""] * 7
        if last > first:
            one = first + int(np.argmax(size[first:last]))
            strongest = [repr(v) for v in [*columns["contact_point"][one].tolist(), *force[one].tolist()]]
            strongest += [str(int(columns[f"contact_{name}"][one])) for name in ("part", "body", "sticking")]
        rows.append([repr(time), Mode(mode).name.lower(), *map(repr, values[step]), str(last - first), *strongest])
    return rows


def _write_npz(path: Path, motions: Sequence[Motion]) -> None:
    import numpy as np

    from resgrid.control.log import Mode

    arrays: dict[str, NDArray[np.generic]] = {
        "k": np.array([motion.k for motion in motions]),
        "start": np.array([motion.start for motion in motions]),
        "outcome": np.array([str(motion.run.ending) for motion in motions]),
        "mode_names": np.array([mode.name.lower() for mode in Mode]),
    }
    for number, motion in enumerate(motions):
        for name, column in columns_of(motion.run).items():
            arrays[f"{name}_{number}"] = column
    with path.open("wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]


def run_data(motion: Motion) -> dict[str, Any]:
    """A run as ``--json`` gives it."""
    import numpy as np

    from resgrid.control.log import Mode

    run = motion.run
    modes, counts = np.unique(run.mode, return_counts=True)
    return {
        "outcome": str(run.ending),
        "message": run.message,
        "goal": run.goal,
        "start": list(motion.start),
        "end": run.configuration[-1],
        "k": motion.k,
        "time": run.time[-1],
        "steps": len(run.time) - 1,
        "modes": {Mode(mode).name.lower(): count for mode, count in zip(modes.tolist(), counts.tolist(), strict=True)},
        "cells_learnt": int(run.learnt.sum()),
        "resolves": len(run.lessons),
        "contacts": len(run.contacts.step),
        "parts_touched": np.unique(run.contacts.part),
        "penetration": run.penetration,
        "cell_motion": motion.simulation.plant.cell_motion,
    }


def run_line(motion: Motion) -> str:
    """A run in one line, for people."""
    run = motion.run
    head = f"start {place_of(motion.start)}, k = {motion.k:g}: {run.ending} after {run.time[-1]:.4g} s"
    solves = "1 re-solve" if len(run.lessons) == 1 else f"{len(run.lessons)} re-solves"
    learnt = f", {int(run.learnt.sum())} cells learnt in {solves}" if run.lessons else ""
    touches = len(run.contacts.step)
    felt = f", {touches} contact{'s' if touches > 1 else ''}" if touches else ""
    why = "" if str(run.ending) == "arrived" else f": {run.message}"
    return f"{head}{felt}{learnt}{why}"
